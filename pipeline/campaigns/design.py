"""`perilife design`: which value of one option keeps a strength for a time.

Each candidate is a life cycle of its own without a report, so that an answer found here is an
answer of `perilife run`.  A root in one dimension for a length, a table for a list of alloys.  With
a probability, the constants are those of the sample whose volume loss is the quantile asked for:
strength falls as the loss grows, so what that sample keeps, the others keep with this probability.
"""

from __future__ import annotations

import argparse
import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.calibration.models import (
    Implant,
    ReducedModel,
    liquid_omission,
    with_constants,
)
from pipeline.campaigns.bands import samples_of
from pipeline.campaigns.options import LENGTHS
from pipeline.life_cycle import LifeCycle
from pipeline.record.progress import Progress
from pipeline.record.run_folder import StageRecord
from pipeline.scene.options import scene_from_options
from pipeline.scene.scene import Scene, SceneError
from pipeline.scene.units import format_length, parse_length, parse_time
from pipeline.stages.opening import open_run

SAMPLES = 400
_WIDTH = 0.01
"""Relative width of the interval at which the search for a length ends."""


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

    def excess(self, target: Target) -> float:
        """Above what is asked for, relative to it."""
        if target.share is not None:
            return self.share / target.share - 1.0
        return self.peak / target.force - 1.0


class _Quietly(LifeCycle):
    """A life cycle without a report."""

    def report(self, again: bool = False) -> StageRecord | None:
        """Nothing: candidates are many."""
        return None


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

    def scene(self, name: str, value: object) -> Scene:
        """The scene of one candidate."""
        options = copy.copy(self.options)
        options.immersion = [self.options.at]
        setattr(options, name, value)
        return scene_from_options(options)

    def evaluate(self, name: str, value: object, label: str) -> Candidate:
        """Run one candidate, unless it was run before."""
        if label in self.tried:
            return self.tried[label]
        scene = self.scene(name, value)
        if self.target.probability is not None:
            scene = self._quantile(scene)
        folder = self.out / f"{name}-{label}".replace("/", "_")
        with open_run(scene, folder, folder.exists()) as (opened, solid):
            rows = _Quietly(scene, opened, solid=solid, progress=self.progress).run()
        row = [row for row in rows if row.hold == scene.holds[0].name][-1]
        found = Candidate(label, row.strength_ratio, row.peak_reaction, row.volume_loss, folder)
        self.tried[label] = found
        self.say(
            f"{name} {label}: {100 * found.share:.1f} % left, {found.peak:.4g} N, "
            f"{100 * found.volume_loss:.2f} % of the volume lost"
        )
        return found

    def _quantile(self, scene: Scene) -> Scene:
        """With the constants of the sample whose volume loss is the quantile asked for."""
        alloy = scene.alloys[0].name
        samples = samples_of(scene, alloy, SAMPLES)
        implant = Implant(scene)
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

    def length(self, name: str, low: float, high: float) -> Candidate:
        """The length (m) between low and high that just keeps the target; SceneError without one.

        The side of the last interval that keeps it, an interval of 1 % of the length.
        """

        def at(value: float) -> Candidate:
            return self.evaluate(name, f"{1e6 * value:.6g}um", format_length(value))

        ends = {low: at(low), high: at(high)}
        keeps = {value: c.excess(self.target) >= 0 for value, c in ends.items()}
        if all(keeps.values()):
            raise SceneError(
                f"{name}: every value tried from {format_length(low)} to {format_length(high)} "
                f"keeps {self.target.in_words()}; the range must hold one that does not"
            )
        if not any(keeps.values()):
            best = max(ends.values(), key=lambda c: c.excess(self.target))
            raise SceneError(
                f"{name}: neither end of {format_length(low)} to {format_length(high)} keeps "
                f"{self.target.in_words()}; the better one, {best.label}, keeps "
                f"{100 * best.share:.1f} % and {best.peak:.4g} N"
            )
        good, bad = (high, low) if keeps[high] else (low, high)
        step = 0
        while abs(good - bad) > _WIDTH * max(good, bad):
            # The secant alone may close in from one side only; every other step halves.
            best, worst = (ends[v].excess(self.target) for v in (good, bad))
            share = 0.5 if step % 2 or best <= worst else best / (best - worst)
            share = min(0.9, max(0.1, share))
            middle = 1e-6 * round(1e6 * (good + share * (bad - good)))
            step += 1
            if middle in (good, bad):  # a micrometre apart
                break
            ends[middle] = at(middle)
            if ends[middle].excess(self.target) >= 0:
                good = middle
            else:
                bad = middle
        return ends[good]

    def alloys(self, names: list[str]) -> list[Candidate]:
        """Each alloy, the one that keeps most first."""
        found = [self.evaluate("alloy", [name], name) for name in names]
        return sorted(found, key=lambda c: -c.excess(self.target))


def run_design(
    options: argparse.Namespace, progress: Progress, say: Callable[[str], None]
) -> Candidate:
    """Do what the options ask; ValueError or OSError with one sentence where that cannot be."""
    name, equals, values = options.vary.partition("=")
    name = name.replace("-", "_")
    known = ", ".join([*(n.replace("_", "-") for n in LENGTHS), "alloy"])
    if not equals or name not in (*LENGTHS, "alloy"):
        raise ValueError(f"--vary is '{options.vary}'; it must be NAME=LOW:HIGH, NAME of {known}")
    target = Target(
        parse_time(options.at, "time").seconds,
        options.strength_left,
        None if options.force is None else _newtons(options.force),
        options.probability,
    )
    if name != "alloy" and len(options.alloy) != 1:
        raise ValueError(
            f"--alloy is {' '.join(options.alloy)}; a design by {name} is of one alloy"
        )
    designer = Designer(options, target, Path(options.out), progress, say)
    if name == "alloy":
        found = designer.alloys([v for v in values.split(",") if v])
        best = found[0]
        if best.excess(target) < 0:
            raise SceneError(
                f"alloy: none of {values} keeps {target.in_words()}; the best, {best.label}, keeps "
                f"{100 * best.share:.1f} % and {best.peak:.4g} N"
            )
    else:
        low, colon, high = values.partition(":")
        if not colon:
            raise ValueError(f"--vary is '{options.vary}'; it must be {name}=LOW:HIGH")
        ends = [parse_length(text, name.replace("_", " ")) for text in (low, high)]
        if not 0 < ends[0] < ends[1]:
            raise ValueError(f"--vary is '{options.vary}'; the range must rise from above 0")
        best = designer.length(name, *ends)
    left = f"{100 * best.share:.1f} % and {best.peak:.4g} N"
    say(
        f"{name.replace('_', ' ')} {best.label} keeps {target.in_words()}: {left}; its run is in "
        f"{best.folder}"
    )
    return best


def _newtons(text: str) -> float:
    try:
        return float(text.removesuffix("N").strip())
    except ValueError:
        raise ValueError(f"--force is '{text}'; write newtons, as 300N") from None
