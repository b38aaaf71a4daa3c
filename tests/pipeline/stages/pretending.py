"""A child that pretends to pull, by the name of the job's folder, for the tests of pulls.

bad: fails with a message; deaf: dies before it begins; hanging: writes its number and waits;
late: ends before it begins, once, as one does that nobody has asked for long; mute: ends well, but
without an answer.
"""

import json
import os
import sys
import time
from pathlib import Path

from pipeline.record.worker import serve

LOG_FILE = "tensile.log"
"""That of pipeline.stages.strength, which would take most of a child's second to import."""


def pretend(job: dict) -> str:
    """As the name of the job's folder says; what is to be prepared fails for "none"."""
    if "prepare" in job:
        if "none" in job["prepare"]:
            sys.exit("no such element")
        time.sleep(0.3)
        return ""
    out = Path(job["out"])
    if out.name == "deaf":
        sys.exit("not a word was heard")
    if out.name == "late" and not (out / "before").exists():
        (out / "before").write_text(str(os.getpid()))
        sys.exit(0)
    (out / LOG_FILE).write_text("begun\n")
    if out.name == "mute":
        sys.exit(0)
    if out.name == "bad":
        (out / LOG_FILE).write_text("begun\nno pivot\n")
        sys.exit(1)
    if out.name == "hanging":
        (out / "pid").write_text(str(os.getpid()))
        time.sleep(60)
    time.sleep(0.3)
    (out / "by").write_text(str(os.getpid()))
    return ""


if __name__ == "__main__":
    if sys.argv[1].isdigit():
        sys.exit(serve(pretend))
    job = Path(sys.argv[1])
    pretend(json.loads(job.read_text()))
