"""Lines for a person and JSON lines for a program."""

import io
import json
import re

import pytest

from pipeline.record import progress
from pipeline.record.progress import LineProgress, progress_for


def happen(observer: progress.Progress, clock: list[float]) -> None:
    """A stage of 40 s, a quarter done after 10 s, one that was done before, and a note."""
    with observer:
        observer.started("corrode Mg-A")
        for clock[0], fraction in ((9.9, 0.2), (20.0, 0.25), (20.5, 0.3), (30.0, 1.0)):
            observer.advanced("corrode Mg-A", fraction, "12 d")
        observer.finished("corrode Mg-A", 30.04, "5.0 % of the metal lost")
        observer.reused("map")
        observer.note("a note with µm")


@pytest.fixture
def clock(monkeypatch) -> list[float]:
    """The time that the observers see."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_lines_say_how_long_it_will_take(clock) -> None:
    stream = io.StringIO()
    happen(LineProgress(stream), clock)
    lines = [re.sub(r"^\[.*?\] ", "", line) for line in stream.getvalue().splitlines()]
    assert lines == [
        "corrode Mg-A: started",
        "corrode Mg-A: 25 %, about 1 min 00 s left 12 d",
        "corrode Mg-A: done in 30 s: 5.0 % of the metal lost",
        "map: complete, kept",
        "a note with µm",
    ]


def test_a_log_is_added_to_and_each_line_is_an_object(clock, tmp_path) -> None:
    path, stream = tmp_path / "log.jsonl", io.StringIO()
    happen(progress_for(stream, quiet=True, log=str(path)), clock)
    happen(progress_for(stream, log=str(path)), clock)
    events = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    assert len(events) == 14 and "corrode Mg-A: started" in stream.getvalue()
    at = [event.pop("at") for event in events]
    assert at == sorted(at) and events[:7] == events[7:]
    assert events[:7] == [
        {"event": "started", "what": "corrode Mg-A"},
        {"event": "advanced", "what": "corrode Mg-A", "fraction": 0.2, "text": "12 d"},
        {"event": "advanced", "what": "corrode Mg-A", "fraction": 0.25, "text": "12 d"},
        {"event": "advanced", "what": "corrode Mg-A", "fraction": 1.0, "text": "12 d"},
        {
            "event": "finished",
            "what": "corrode Mg-A",
            "seconds": 30.04,
            "text": "5.0 % of the metal lost",
        },
        {"event": "reused", "what": "map"},
        {"event": "note", "text": "a note with µm"},
    ]
    with pytest.raises(OSError):
        progress_for(stream, log=str(tmp_path / "absent" / "log.jsonl"))
