"""What makes the strength left of a run unsure, source by source: doubts.json of a run folder."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from pipeline.record.run_folder import write_json

DOUBTS_FILE = "doubts.json"


@dataclass(frozen=True)
class Source:
    """One source of doubt in the strength left, in shares of the intact strength.

    deviation: standard deviation, None where it was not computed; low, high: ends of what the
    source makes of the strength left, where they are known; basis: from what, or why not.
    """

    name: str
    deviation: float | None
    low: float | None
    high: float | None
    basis: str


@dataclass(frozen=True)
class Next:
    """What one more measurement of the volume loss leaves: standard deviations at the last time.

    days: when it is made; volume_loss, strength_left: as shares.
    """

    days: float
    volume_loss: float
    strength_left: float


@dataclass(frozen=True)
class HoldDoubts:
    """One alloy held in one way at the last immersion time of a run.

    volume_loss, strength_left: those of the run; slope: d strength left / d volume loss there;
    sources: the doubts; constants: share of the samples' variance of the strength left that
    knowing a constant exactly would remove, by name (they overlap where constants are correlated);
    now: the deviations before any further measurement; after: with one more; scatter: standard
    deviation of that measurement.
    """

    alloy: str
    hold: str
    immersion_days: float
    volume_loss: float
    strength_left: float
    slope: float
    sources: tuple[Source, ...]
    constants: dict[str, float]
    now: Next
    after: tuple[Next, ...]
    scatter: float


def write_doubts(path: Path, found: list[HoldDoubts]) -> None:
    """Write the doubts as JSON in one step."""
    write_json(path, {"doubts": [asdict(one) for one in found]})


def read_doubts(path: Path) -> list[HoldDoubts]:
    """What `write_doubts` wrote; none where there is no such file, ValueError for another one."""
    if not path.is_file():
        return []
    try:
        content = json.loads(path.read_text(encoding="utf-8"))["doubts"]
        return [
            HoldDoubts(
                **{
                    **one,
                    "sources": tuple(Source(**source) for source in one["sources"]),
                    "now": Next(**one["now"]),
                    "after": tuple(Next(**row) for row in one["after"]),
                }
            )
            for one in content
        ]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"'{path}' cannot be read: {error}") from None
