"""`perilife design`: which value of one option keeps a strength for a time, or the front of two.

Each candidate is a life cycle of its own without a report, so that an answer found here is an
answer of `perilife run`: a root for a range, every value of a list, and for two options the root
in the first at each value of the second.  A coating in clean liquid changes the time only, so it
is searched by the reduced model and one strength curve, and its answer verified by one full run.
With a probability, the constants are those of the sample whose volume loss is the quantile asked
for: strength falls as the loss grows, so what that sample keeps, the others keep with it.
"""

from __future__ import annotations

import argparse
import csv
import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.calibration.models import (
    Implant,
    ReducedModel,
    constants,
    liquid_omission,
    with_constants,
)
from pipeline.calibration.strength_curve import StrengthCurve
from pipeline.campaigns.banded import samples_of
from pipeline.campaigns.options import COATING
from pipeline.campaigns.strength import CURVE_FOLDER, CurveTests, curve_to
from pipeline.campaigns.varied import Choice, Range, changed, read_vary
from pipeline.life_cycle import StagedRun
from pipeline.planning.opening import open_run
from pipeline.record.machine import processor_cores
from pipeline.record.progress import Progress
from pipeline.record.run_folder import StageRecord, write_text
from pipeline.scene.command.options import scene_from_options
from pipeline.scene.scene import Scene, SceneError
from pipeline.scene.units import parse_time

SAMPLES = 400
DESIGN_FILE = "design.csv"
_WIDTH = 0.01
"""Relative width of the interval at which the search of a range ends."""


@dataclass(frozen=True)
class Target:
    """What is to be kept: a share of the intact strength, or a force (N, or N m), at a time (s)."""

    at: float
    share: float | None = None
    force: float | None = None
    probability: float | None = None

    def __post_init__(self) -> None:
        if (self.share is None) == (self.force is None):
            raise ValueError("give either --strength-left or --force, exactly one of them")
        for name, value in (("--strength-left", self.share), ("--probability", self.probability)):
            if value is not None and not 0 < value < 1:
                raise ValueError(f"{name} is {value:g}; it must be above 0 and below 1")
        if self.force is not None and not 0 < self.force < math.inf:
            raise ValueError(f"--force is {self.force:g} N; it must be above 0")

    def in_words(self) -> str:
        """What is asked for."""
        what = f"{self.force:g} N" if self.share is None else f"{100 * self.share:g} %"
        chance = "" if self.probability is None else f" with probability {self.probability:g}"
        return f"{what} after {self.at / 604800:g} weeks{chance}"


@dataclass(frozen=True)
class Candidate:
    """One value tried: label, what is left (share and N or N m) and what was lost at the time."""

    label: str
    share: float
    peak: float
    volume_loss: float
    folder: Path

    def in_words(self) -> str:
        """What is left and what was lost."""
        return (
            f"{100 * self.share:.1f} % left, {self.peak:.4g} N, "
            f"{100 * self.volume_loss:.2f} % of the volume lost"
        )

    def excess(self, target: Target) -> float:
        """Above what is asked for, relative to it."""
        if target.share is not None:
            return self.share / target.share - 1.0
        return self.peak / target.force - 1.0


class _Quietly(StagedRun):
    """A life cycle without a report."""

    def report(self, again: bool = False) -> StageRecord | None:
        """Nothing: candidates are many."""
        return None


class NoAnswerError(SceneError):
    """No value of a range or a list keeps the target, or every value does."""


class Designer:
    """Tries values of one option in run folders below `out`.

    options: parsed, as for `perilife run`; each candidate is their scene with one option changed.
    """

    def __init__(
        self,
        options: argparse.Namespace,
        target: Target,
        out: Path,
        progress: Progress | None = None,
        say: Callable[[str], None] = lambda line: None,
    ):
        self.options, self.target, self.out = options, target, out
        self.progress, self.say = progress, say
        self.tried: dict[str, Candidate] = {}

    def scene(self, name: str, text: str) -> Scene:
        """The scene of one candidate."""
        options = changed(self.options, name, text)
        options.immersion = [self.options.at]
        return scene_from_options(options)

    def evaluate(self, name: str, text: str, label: str) -> Candidate:
        """Run one candidate, unless it was run before."""
        if label in self.tried:
            return self.tried[label]
        scene = self.scene(name, text)
        if self.target.probability is not None:
            scene = self._quantile(scene)
        folder = self.out / f"{name}-{label}".replace("/", "_").replace(" ", "-")
        with open_run(scene, folder, folder.exists()) as (opened, solid):
            rows = _Quietly(scene, opened, solid=solid, progress=self.progress).run()
        row = [row for row in rows if row.hold == scene.holds[0].name][-1]
        found = Candidate(label, row.strength_ratio, row.peak_reaction, row.volume_loss, folder)
        return self._note(name, found)

    def _note(self, name: str, found: Candidate) -> Candidate:
        self.tried[found.label] = found
        self.say(f"{name.replace('_', ' ')} {found.label}: {found.in_words()}")
        return found

    def implant(self, scene: Scene) -> Implant:
        """The solid of a scene on its lattice."""
        return Implant(scene)

    def _quantile(self, scene: Scene) -> Scene:
        """With the constants of the sample whose volume loss is the quantile asked for."""
        alloy = scene.alloys[0].name
        samples = samples_of(scene, alloy, SAMPLES)
        implant = self.implant(scene)
        model = ReducedModel(scene, alloy, implant, samples.names)
        at = np.array([self.target.at])
        losses = np.array([model(at, np.log(row))[0][0] for row in samples.values])
        rank = math.ceil(self.target.probability * len(losses)) - 1
        chosen = with_constants(scene, alloy, samples.constants(int(np.argsort(losses)[rank])))
        omission = liquid_omission(chosen, alloy, implant, self.target.at)
        if not omission.applied:
            raise SceneError(
                f"--probability: the liquid of {alloy} cannot be left out ({omission.reason}), so "
                "a sample's rank is not known without marching all; leave --probability out"
            )
        return chosen

    def root(self, vary: Range) -> Candidate:
        """The value of a range that just keeps the target; NoAnswerError without one.

        The side of the last interval that keeps it, an interval of 1 % of the value.
        """
        show = vary.scalar.show

        def at(value: float) -> Candidate:
            return self.evaluate(vary.name, vary.scalar.write(value), show(value))

        name = vary.name.replace("_", " ")
        ends = {value: at(value) for value in (vary.low, vary.high)}
        keeps = {value: c.excess(self.target) >= 0 for value, c in ends.items()}
        if all(keeps.values()):
            raise NoAnswerError(
                f"{name}: every value tried from {show(vary.low)} to {show(vary.high)} keeps "
                f"{self.target.in_words()}; the range must hold one that does not"
            )
        if not any(keeps.values()):
            best = max(ends.values(), key=lambda c: c.excess(self.target))
            raise NoAnswerError(
                f"{name}: neither end of {show(vary.low)} to {show(vary.high)} keeps "
                f"{self.target.in_words()}; the better one, {best.label}, keeps "
                f"{100 * best.share:.1f} % and {best.peak:.4g} N"
            )
        good, bad = (vary.high, vary.low) if keeps[vary.high] else (vary.low, vary.high)
        step = 0
        while abs(good - bad) > _WIDTH * max(good, bad):
            # The secant alone may close in from one side only; every other step halves.
            best, worst = (ends[v].excess(self.target) for v in (good, bad))
            share = 0.5 if step % 2 or best <= worst else best / (best - worst)
            share = min(0.9, max(0.1, share))
            middle = vary.rounded(good + share * (bad - good))
            step += 1
            if middle in (good, bad):  # a grain apart
                break
            ends[middle] = at(middle)
            if ends[middle].excess(self.target) >= 0:
                good = middle
            else:
                bad = middle
        return ends[good]

    def best(self, vary: Choice) -> Candidate:
        """The value of a list that keeps most; NoAnswerError where none keeps the target."""
        found = [self.evaluate(vary.name, value, value) for value in vary.values]
        best = max(found, key=lambda c: c.excess(self.target))
        if best.excess(self.target) < 0:
            raise NoAnswerError(
                f"{vary.name.replace('_', ' ')}: none of {', '.join(vary.values)} keeps "
                f"{self.target.in_words()}; the best, {best.label}, keeps "
                f"{100 * best.share:.1f} % and {best.peak:.4g} N"
            )
        return best

    def search(self, vary: Range | Choice) -> Candidate:
        """The answer of a range or of a list."""
        return self.root(vary) if isinstance(vary, Range) else self.best(vary)


class CoatingDesigner(Designer):
    """Searches a number of the coating in clean liquid without runs; its answer is run.

    tolerance: of the strength curve, which is made once, of the volume losses of the range.
    """

    def __init__(self, *given: Any, tolerance: float = 0.01):
        super().__init__(*given)
        self.tolerance = tolerance
        self._texts: dict[str, str] = {}
        self._known: Implant | None = None
        self._curve: StrengthCurve | None = None

    def implant(self, scene: Scene) -> Implant:
        """One for all candidates: a coating changes nothing of it."""
        self._known = self._known or super().implant(scene)
        return self._known

    def _loss(self, name: str, text: str) -> float:
        scene = self.scene(name, text)
        if self.target.probability is not None:
            scene = self._quantile(scene)
        alloy = scene.alloys[0].name
        known = constants(scene, alloy)
        model = ReducedModel(scene, alloy, self.implant(scene), tuple(known))
        return float(model(np.array([self.target.at]), np.log(list(known.values())))[0][0])

    def evaluate(self, name: str, text: str, label: str) -> Candidate:
        """One candidate by the reduced model and the strength curve."""
        if label in self.tried:
            return self.tried[label]
        self._texts[label] = text
        assert self._curve is not None
        loss = self._loss(name, text)
        peak = float(self._curve([loss])[0])
        return self._note(name, Candidate(label, peak / self._curve.whole, peak, loss, self.out))

    def root(self, vary: Range) -> Candidate:
        """The value that just keeps the target by the curve, verified by one full run."""
        losses = sorted(self._loss(vary.name, vary.scalar.write(v)) for v in (vary.low, vary.high))
        scene = self.scene(vary.name, vary.scalar.write(vary.low))
        tests = CurveTests(
            scene, scene.alloys[0].name, self.implant(scene), self.out / CURVE_FOLDER,
            workers=processor_cores(), progress=self.progress,
        )  # fmt: skip
        self._curve = curve_to(
            tests, scene.holds[0].name, losses[1], self.tolerance, self.say, smallest_loss=losses[0]
        )
        found = super().root(vary)
        runs = Designer(self.options, self.target, self.out, self.progress)
        full = runs.evaluate(vary.name, self._texts[found.label], found.label)
        off = 100 * (full.share - found.share)
        self.say(f"the full run: {full.in_words()}, {off:+.2f} %-points from the curve")
        return full


def front(
    make: Callable[[argparse.Namespace, Path], Designer],
    options: argparse.Namespace,
    out: Path,
    first: Range | Choice,
    second: Range | Choice,
    say: Callable[[str], None] = lambda line: None,
) -> list[tuple[str, Candidate | str]]:
    """The answer in the first option at each value of the second, or why there is none."""
    rows: list[tuple[str, Candidate | str]] = []
    for text in second.points():
        say(f"--- {second.name.replace('_', ' ')} {text}")
        place = f"{second.name}-{text}".replace("/", "_").replace(" ", "-")
        designer = make(changed(options, second.name, text), out / place)
        try:
            rows.append((text, designer.search(first)))
        except NoAnswerError as error:
            rows.append((text, str(error)))
    return rows


def write_design(path: Path, names: list[str], rows: list[tuple[list[str], Candidate]]) -> None:
    """design.csv: the values of the options, what is left, and where its run is."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([*names, "strength_ratio", "peak_N_or_N_m", "volume_loss", "run"])
    for labels, found in rows:
        numbers = (f"{v:.10g}" for v in (found.share, found.peak, found.volume_loss))
        writer.writerow([*labels, *numbers, str(found.folder)])
    write_text(path, buffer.getvalue())


def run_design(options: argparse.Namespace, progress: Progress, say: Callable[[str], None]) -> None:
    """Do what the options ask; ValueError or OSError with one sentence where that cannot be."""
    varied = [read_vary(text) for text in options.vary]
    if len(varied) > 2 or len({vary.name for vary in varied}) < len(varied):
        raise ValueError(
            f"--vary is given for {', '.join(v.name for v in varied)}; give one or two"
        )
    target = Target(
        parse_time(options.at, "time").seconds,
        options.strength_left,
        None if options.force is None else _newtons(options.force),
        options.probability,
    )
    if "alloy" not in {vary.name for vary in varied} and len(options.alloy) != 1:
        named = varied[0].name.replace("_", " ")
        raise ValueError(
            f"--alloy is {' '.join(options.alloy)}; a design by {named} is of one alloy"
        )
    for vary in varied:
        for text in vary.points():
            _scene(changed(options, vary.name, text))
    out = Path(options.out)

    def make(chosen: argparse.Namespace, folder: Path) -> Designer:
        given = (chosen, target, folder, progress, say)
        if varied[0].name in COATING and isinstance(varied[0], Range) and _is_clean(chosen, target):
            return CoatingDesigner(*given, tolerance=options.strength_tolerance)
        return Designer(*given)

    if len(varied) == 1:
        designer = make(options, out)
        found = designer.search(varied[0])
        rows = [([c.label], c) for c in designer.tried.values()]
        write_design(out / DESIGN_FILE, [varied[0].name], rows)
        say(
            f"{varied[0].name.replace('_', ' ')} {found.label} keeps {target.in_words()}: "
            f"{100 * found.share:.1f} % and {found.peak:.4g} N; its run is in {found.folder}"
        )
        return
    first, second = varied
    rows = front(make, options, out, first, second, say)
    answers = [([text, c.label], c) for text, c in rows if isinstance(c, Candidate)]
    say(f"what just keeps {target.in_words()}:")
    for text, found in rows:
        lead = f"{second.name.replace('_', ' ')} {text}"
        if isinstance(found, Candidate):
            say(f"  {lead}: {first.name.replace('_', ' ')} {found.label}, {found.in_words()}")
        else:
            say(f"  {lead}: {found}")
    if not answers:
        raise NoAnswerError(f"no {second.name.replace('_', ' ')} has an answer (see above)")
    write_design(out / DESIGN_FILE, [second.name, first.name], answers)
    say(f"table: {out / DESIGN_FILE}")


def _is_clean(options: argparse.Namespace, target: Target) -> bool:
    """Whether the bare metal's liquid may be left out until the target's time."""
    scene = _scene(options)
    alloy = scene.alloys[0].name
    return liquid_omission(scene, alloy, Implant(scene), target.at).applied


def _scene(options: argparse.Namespace) -> Scene:
    return scene_from_options(argparse.Namespace(**{**vars(options), "immersion": [options.at]}))


def _newtons(text: str) -> float:
    try:
        return float(text.removesuffix("N").strip())
    except ValueError:
        raise ValueError(f"--force is '{text}'; write newtons, as 300N") from None
