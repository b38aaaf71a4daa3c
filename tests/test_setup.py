"""The set-up script where it lacks packages: what it says, and how it asks for them.

Everything it would really call is replaced by stubs on PATH. That it works on a bare machine is
tried by .ci/try-bare-debian, which takes minutes and needs root.
"""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TOOLS = ["bash", "comm", "dirname", "env", "flock", "mktemp", "rm", "sed", "sort", "tail", "tr"]
LISTED = re.findall(
    r"^[a-z0-9][\w.+-]*$", (ROOT / ".ci/debian-packages.txt").read_text(), re.MULTILINE
)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Return a folder with the set-up script and a PATH folder `bin` of tools and stubs."""
    shutil.copytree(ROOT / ".ci", tmp_path / ".ci")
    (tmp_path / "bin").mkdir()
    for tool in TOOLS:
        (tmp_path / "bin" / tool).symlink_to(shutil.which(tool))
    return tmp_path


def stub(checkout: Path, name: str, script: str) -> None:
    path = checkout / "bin" / name
    path.write_text(f"#!{shutil.which('bash')}\n{script}\n")
    path.chmod(0o755)


def set_up(checkout: Path) -> subprocess.CompletedProcess:
    environment = {"PATH": str(checkout / "bin"), "CALLS": str(checkout / "calls")}
    return subprocess.run(
        [str(checkout / ".ci/setup")], env=environment, capture_output=True, text=True, check=False
    )


def installed(checkout: Path, packages: list[str]) -> None:
    lines = "".join(f"installed {name}\\n" for name in packages)
    stub(checkout, "dpkg-query", f"printf '{lines}'")


def test_without_root_and_sudo_it_names_what_is_missing(checkout: Path) -> None:
    assert len(LISTED) > 5
    installed(checkout, [name for name in LISTED if name not in ("gcc", "libegl1")])
    stub(checkout, "id", "echo 1000")
    done = set_up(checkout)
    assert done.returncode == 2
    assert done.stderr == (
        "make setup: needs root or sudo to install these missing Debian packages: gcc libegl1\n"
    )


def test_a_sudo_that_refuses_is_no_sudo(checkout: Path) -> None:
    installed(checkout, LISTED[1:])
    stub(checkout, "id", "echo 1000")
    stub(checkout, "sudo", "exit 1")
    done = set_up(checkout)
    assert done.returncode == 2
    assert f"these missing Debian packages: {LISTED[0]}\n" in done.stderr


@pytest.mark.parametrize(("user", "through"), [("0", "env"), ("1000", "sudo")])
def test_it_installs_as_root_or_through_sudo_and_reports_a_failure(
    checkout: Path, user: str, through: str
) -> None:
    installed(checkout, [name for name in LISTED if name != "gcc"])
    stub(checkout, "id", f"echo {user}")
    stub(checkout, "sudo", 'echo "sudo $*" >>"$CALLS"; [ "$1" = -v ] || exec "$@"')
    stub(checkout, "apt-get", 'echo "apt-get $*" >>"$CALLS"; [ "$2" = update ] || exit 1')
    done = set_up(checkout)
    assert done.returncode == 2
    assert done.stderr == "make setup: apt-get could not install: gcc\n"
    calls = (checkout / "calls").read_text().splitlines()
    assert "apt-get -qq update" in calls
    assert calls[-1] == "apt-get -qq install -y --no-install-recommends gcc"
    assert any(call.startswith("sudo env ") for call in calls) == (through == "sudo")


def test_elsewhere_than_on_debian_it_says_so(checkout: Path) -> None:
    done = set_up(checkout)
    assert done.returncode == 2
    assert "this is not a Debian system" in done.stderr


def test_every_python_package_is_pinned_to_one_version() -> None:
    lines = (ROOT / ".ci/requirements.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert len(pins) > 20
    assert [pin for pin in pins if not re.fullmatch(r"[\w.-]+==[\w.+!]+", pin)] == []
    project = (ROOT / "pyproject.toml").read_text()
    needed = re.findall(r'^    "([\w-]+)[<>=]', project, re.MULTILINE)
    assert {"numpy", "numba", "gmsh"} <= set(needed)
    pinned = {pin.split("==")[0].lower() for pin in pins}
    # These two come from Debian, with dolfinx.
    assert {name.lower() for name in needed} - pinned == {"scipy", "h5py"}
