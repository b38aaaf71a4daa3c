"""The runs of a comparison: read, named, and refused where they cannot be compared."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.record.run_folder import RunFolder, RunFolderError
from pipeline.record.run_results import AlloyResult, ImmersionResult, RunResults, read_run
from pipeline.report.drawing import MOST_LINES
from pipeline.scene.holding import GIVEN, HOLDINGS
from pipeline.scene.loads import LOADS, LoadNames
from pipeline.scene.scene import HoldScene
from pipeline.scene.units import format_length


@dataclass(frozen=True)
class Line:
    """One alloy of one run, drawn alike everywhere.

    number: decides colour, marker and dashes; label: for a reader, unique.
    """

    number: int
    label: str
    run_label: str
    alloy: str
    run: RunResults

    def held(self, way: Way) -> AlloyResult | None:
        """Its results held in one way; None where the run did not test so."""
        for hold in self.run.scene.holds:
            if way_of(hold) == way:
                return next(a for a in self.run.held[hold.name] if a.name == self.alloy)
        return None

    @property
    def corroded(self) -> AlloyResult:
        """Its results in the run's first way of holding: corrosion is alike in all."""
        return next(a for a in self.run.alloys if a.name == self.alloy)


@dataclass(frozen=True)
class Way:
    """What makes strengths comparable: the load and the way of holding.

    depths: of grips given one by one (m), which have no name.
    """

    load: str
    hold: str
    depths: tuple[float, float] | None = None

    @property
    def names(self) -> LoadNames:
        """What the results of the load are called."""
        return LOADS[self.load]

    @property
    def part(self) -> str:
        """What is tested, for a reader."""
        part = HOLDINGS[self.hold].part
        if self.depths is None:
            return part
        bottom, top = (format_length(d).replace("um", "µm") for d in self.depths)
        return f"{part} (bottom {bottom}, top {top})"


def way_of(hold: HoldScene) -> Way:
    """The load and the way of holding of a test."""
    test = hold.tensile
    own = hold.name == GIVEN
    return Way(test.load, hold.name, (test.bottom_grip, test.top_grip) if own else None)


def read_runs(paths: Sequence[str | Path]) -> list[Line]:
    """The lines of the runs in these folders, in their order.

    Raises FileNotFoundError, RunFolderError or ValueError with one sentence where there are too
    few or too many runs, one stands there twice, or one holds no results.
    """
    if len(paths) < 2:
        raise ValueError(f"{len(paths)} run folder was given; a comparison needs at least 2")
    places = [Path(path).resolve() for path in paths]
    for n, place in enumerate(places):
        if place in places[:n]:
            raise ValueError(f"run folder '{paths[n]}' was given twice; it must be given once")
    runs = [_read(path) for path in paths]
    lines: list[Line] = []
    several = len({alloy.name for run in runs for alloy in run.scene.alloys}) > 1
    for run, label in zip(runs, _labels(places), strict=True):
        for alloy in run.scene.alloys:
            text = f"{label}, {alloy.name}" if several else label
            lines.append(Line(len(lines), text, label, alloy.name, run))
    if len(lines) > MOST_LINES:
        raise ValueError(
            f"the run folders hold {len(lines)} results of an alloy; a comparison draws at most "
            f"{MOST_LINES} of them"
        )
    return lines


def _read(path: str | Path) -> RunResults:
    folder = RunFolder(path)
    if not folder.path.is_dir():
        raise FileNotFoundError(f"run folder '{path}' does not exist")
    if not folder.scene_file.is_file():
        raise RunFolderError(f"'{path}' holds no {folder.scene_file.name}, so it is no run folder")
    run = read_run(path, fields=False)
    if not any(item.summary for alloy in run.alloys for item in alloy.immersions):
        raise RunFolderError(
            f"run folder '{path}' holds no results in {folder.summary_file.name}; "
            f"`perilife run ... --out {path} --resume` completes it"
        )
    return run


def _labels(places: Sequence[Path]) -> list[str]:
    """The end of each path, as long as it takes to tell them apart."""
    most = max(len(place.parts) for place in places)
    for count in range(1, most + 1):
        names = ["/".join(place.parts[-count:]).replace("//", "/") for place in places]
        if len(set(names)) == len(names):
            return names
    raise ValueError("the run folders are the same; each must be given once")


def ways(lines: Sequence[Line]) -> list[Way]:
    """Every load and way of holding of the runs, in the order in which they come."""
    return list(dict.fromkeys(way_of(h) for line in lines for h in line.run.scene.holds))


def tested(result: AlloyResult) -> Iterator[ImmersionResult]:
    """The times of an alloy that have a strength left."""
    return (item for item in result.immersions if item.strength_ratio is not None)


def same_time(one: float, other: float) -> bool:
    """Whether two times (s) are one, whatever unit they were typed in."""
    return abs(one - other) <= 1e-6 * (86400.0 + one)


def times(items: Sequence[float]) -> list[float]:
    """Rising times (s), each once."""
    found: list[float] = []
    for seconds in sorted(items):
        if not found or not same_time(found[-1], seconds):
            found.append(seconds)
    return found
