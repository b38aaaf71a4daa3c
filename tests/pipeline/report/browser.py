"""A page in Debian's chromium without a screen, spoken to in the DevTools protocol over pipes.

Needed by the slow test of the report only.  Everything that chromium writes is in one folder.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType

MISSING = (
    "chromium is not installed; it must be for this test alone: "
    "apt-get install --no-install-recommends chromium"
)
_PATIENCE = 120.0
"""Seconds for an answer: WebGL in software on a busy machine."""


class Browser:
    """One page.  `problems` holds what its console and log complained of, `asked` its requests."""

    def __init__(self, folder: Path) -> None:
        program = shutil.which("chromium")
        if program is None:
            raise FileNotFoundError(MISSING)
        self.problems: list[str] = []
        self.asked: list[str] = []
        self._count, self._buffer, self._session = 0, b"", ""
        theirs_in, self._to = os.pipe()
        self._from, theirs_out = os.pipe()

        def places() -> None:  # chromium listens at 3 and answers at 4
            spare = [os.dup(end) for end in (theirs_in, theirs_out)]
            os.dup2(spare[0], 3)
            os.dup2(spare[1], 4)

        self._log = open(folder / "chromium.log", "w")  # noqa: SIM115, closed with the page
        self._process = subprocess.Popen(
            [
                program,
                "--headless=new",
                "--no-sandbox",  # tests may run as root
                "--no-first-run",
                "--hide-scrollbars",
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
                f"--user-data-dir={folder / 'profile'}",
                "--remote-debugging-pipe",
                "about:blank",
            ],
            close_fds=False,
            preexec_fn=places,
            stdout=self._log,
            stderr=self._log,
            env={**os.environ, "HOME": str(folder)},
        )
        os.close(theirs_in)
        os.close(theirs_out)
        targets = self.send("Target.getTargets")["targetInfos"]
        page = next(target for target in targets if target["type"] == "page")
        attached = self.send("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.terminate()
        self._process.wait(30)
        os.close(self._to)
        os.close(self._from)
        self._log.close()

    def send(self, method: str, **parameters: object) -> dict:
        """Ask for something and wait for the answer; what is reported meanwhile is kept."""
        self._count += 1
        message: dict = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self._hear(answer)

    def _read(self) -> dict:
        until = time.monotonic() + _PATIENCE
        while b"\0" not in self._buffer:
            if not select.select([self._from], [], [], max(0.0, until - time.monotonic()))[0]:
                raise TimeoutError("chromium does not answer")
            got = os.read(self._from, 1 << 20)
            if not got:
                raise RuntimeError("chromium has ended")
            self._buffer += got
        line, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(line)

    def _hear(self, event: dict) -> None:
        name, what = event.get("method"), event.get("params", {})
        if name == "Runtime.exceptionThrown":
            details = what["exceptionDetails"]
            self.problems.append(details.get("exception", {}).get("description", str(details)))
        elif name == "Runtime.consoleAPICalled" and what["type"] in ("error", "warning", "assert"):
            self.problems.append(str(what["args"]))
        elif name == "Log.entryAdded" and what["entry"]["level"] in ("error", "warning"):
            self.problems.append(what["entry"]["text"])
        elif name == "Network.requestWillBeSent":
            self.asked.append(what["request"]["url"])

    def show(self, page: Path, width: int = 1100, height: int = 900, dark: bool = False) -> None:
        """Open a file in a window of this size, and wait until it has settled."""
        self.resize(width, height)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.send("Emulation.setEmulatedMedia", features=scheme)
        self.send("Page.navigate", url=page.resolve().as_uri())
        self.wait_for("document.readyState === 'complete'")

    def resize(self, width: int, height: int) -> None:
        """Give the window another size, with one device pixel for each of CSS."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.send("Emulation.setDeviceMetricsOverride", **size)

    def value(self, script: str) -> object:
        """The value of an expression in the page; a promise is waited for."""
        found = self.send(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in found:
            raise RuntimeError(str(found["exceptionDetails"].get("exception", found)))
        return found["result"].get("value")

    def wait_for(self, script: str) -> None:
        """Until an expression in the page is true."""
        until = time.monotonic() + _PATIENCE
        while not self.value(f"!!({script})"):
            if time.monotonic() > until:
                raise TimeoutError(f"never true in the page: {script}")
            time.sleep(0.05)

    def mouse(self, kind: str, x: float, y: float, pressed: bool = False) -> None:
        """Move the mouse, or press or release its left button, at a place in the window."""
        button = "left" if pressed or kind != "mouseMoved" else "none"
        self.send(
            "Input.dispatchMouseEvent",
            type=kind, x=x, y=y, button=button, buttons=int(pressed), clickCount=1,
        )  # fmt: skip

    def picture(self, path: Path | None = None, whole: bool = False) -> bytes:
        """PNG of the window or of the whole page, written to `path`, too, where one is given."""
        shot = self.send("Page.captureScreenshot", captureBeyondViewport=whole)
        content = base64.b64decode(shot["data"])
        if path is not None:
            path.write_bytes(content)
        return content
