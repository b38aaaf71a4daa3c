"""SIGKILL at random moments of a run, as a machine without memory sends it: nothing survives, and
--resume ends with the numbers of a run that was left alone."""

import os
import random
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from tests.end_to_end.test_coarse_run import OPTIONS, ROOT
from tests.pipeline.processes import survivors

pytest.importorskip("dolfinx", reason="the tensile test needs dolfinx")
pytestmark = pytest.mark.slow

KILLS = 10
"""Of each number of ranks."""


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_run_that_is_killed_at_random_leaves_nothing_behind_and_resumes_to_the_same_numbers(
    tmp_path, ranks
):
    begun = time.monotonic()
    run = _Run(tmp_path / "whole", ranks)
    assert run.finish() == 0, run.told()
    expected = (run.out / "summary.csv").read_text()
    whole = time.monotonic() - begun

    dice, kills, ended = random.Random(ranks), Counter(), 0
    out = tmp_path / "run-0"
    while sum(kills.values()) < KILLS:
        run = _Run(out, ranks)
        end = time.monotonic() + dice.uniform(0.05, 0.7) * whole
        while time.monotonic() < end and run.process.poll() is None:
            time.sleep(0.01)
        if run.process.poll() is None:
            run.kill()
            kills[run.stage()] += 1
            if run.stage() != "report":
                continue
            run = _Run(out, ranks)  # what is left is the report alone: to the end, then anew
        assert run.finish() == 0, run.told()
        assert (out / "summary.csv").read_text() == expected
        ended += 1
        out = tmp_path / f"run-{ended}"
    run = _Run(out, ranks)
    assert run.finish() == 0, run.told()
    assert (out / "summary.csv").read_text() == expected
    leftovers = [p.name for p in out.rglob("*") if p.name.startswith(".") or ".part" in p.suffixes]
    assert leftovers == []
    print(f"{ranks} ranks: killed in {dict(kills)}, {ended + 1} runs completed")
    assert len(kills) >= 2  # not always at the same place
    assert kills["pull"] >= 1


class _Run:
    """A run in a process of its own, begun or gone on with in `out`."""

    def __init__(self, out: Path, ranks: int) -> None:
        self.out, self.mark = out, f"perilife-kill-{os.getpid()}-{ranks}-{time.monotonic_ns()}"
        self.log = out.with_suffix(".log")
        command = [sys.executable, "-m", "pipeline.cli", "run", *OPTIONS, "--out", str(out)]
        command += ["--np", str(ranks), "--oversubscribe", "--resume"]
        environment = {**os.environ, "PERILIFE_TEST_MARK": self.mark, "OMP_NUM_THREADS": "1"}
        environment["PYTHONPATH"] = os.pathsep.join(
            part for part in (str(ROOT), os.environ.get("PYTHONPATH")) if part
        )
        with open(self.log, "w") as log:
            self.process = subprocess.Popen(
                command, stdout=log, stderr=log, env=environment, start_new_session=True
            )

    def finish(self) -> int:
        return self.process.wait(timeout=600)

    def kill(self) -> None:
        """Kill the run alone; what it started must end by itself."""
        assert survivors(self.mark)
        self.process.kill()
        self.process.wait()
        end = time.monotonic() + 20.0
        while left := survivors(self.mark):
            assert time.monotonic() < end, f"still there: {left}"
            time.sleep(0.02)

    def stage(self) -> str:
        """What ran last, by the progress: `corrode`, `pull`; "start" before anything did."""
        started = [line.split("] ")[1] for line in self.told().splitlines() if "started" in line]
        return started[-1].split()[0].rstrip(":") if started else "start"

    def told(self) -> str:
        return self.log.read_text()
