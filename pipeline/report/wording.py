"""Sentences and numbers as a reader of the report wants them."""

import math
from collections.abc import Iterable

from pipeline.record.run_results import AlloyResult, ImmersionResult, column
from pipeline.scene.holding import HOLDINGS
from pipeline.scene.loads import LOADS, LoadNames

STATUS_WORDS = {
    "completed": "{done} to the end",
    "past_peak": "{done} past its peak",
    "severed": "severed: carries nothing",
    "fully_corroded": "fully corroded",
}


def headline(alloy: AlloyResult, names: LoadNames = LOADS["axial"]) -> str:
    """The answer for one alloy held in one way in one sentence, from what was tested."""
    tested = [i for i in alloy.immersions if i.strength_ratio is not None]
    immersed = [i for i in tested if i.seconds > 0]
    if not immersed:
        intact = [i for i in tested if i.seconds == 0]
        if intact and intact[0].summary:
            most = names.shown(intact[0].summary.peak_reaction)
            when = "was tested only before immersion"
            return f"{alloy.name} {when}; the intact solid carries {most}."
        loss = column(alloy.history, "volume_loss")
        lost = ""
        if loss is not None and alloy.immersions:
            lost = f"; it lost {percent(loss[-1], 1)} of its volume in {_last_time(alloy)}"
        return f"No {names.test} of {alloy.name} is in this run{lost}."
    last = immersed[-1]
    halfway = [i for i in immersed[:-1] if i.strength_ratio > 0.0]
    parts = []
    if halfway:
        middle = min(halfway, key=lambda i: abs(math.log(i.seconds / (last.seconds / 3.0))))
        kept = percent(middle.strength_ratio)
        parts.append(f"{kept} of its {names.strength} after {duration(middle.seconds)}")
    gone = [i for i in immersed if i.strength_ratio == 0.0]
    share = "" if parts else f" of its {names.strength}"
    if gone:
        ending = f"none{share} after {duration(gone[0].seconds)}, when it no longer holds together"
    else:
        ending = f"{percent(last.strength_ratio)}{share} after {duration(last.seconds)}"
    parts.append(ending)
    sentence = f"{alloy.name}: {HOLDINGS[alloy.hold].part} keeps " + " and ".join(parts)
    half = half_strength_time(alloy)
    if half is not None and not any(duration(half, rough=True) in part for part in parts):
        sentence += f"; half of it is gone after about {duration(half, rough=True)}"
    return sentence + "."


def elsewhere(others: Iterable[AlloyResult]) -> str:
    """The same alloy held in other ways: what it keeps after the last time, in one sentence."""
    parts = []
    for other in others:
        tested = [i for i in other.immersions if i.strength_ratio is not None and i.seconds > 0]
        if tested:
            kept = percent(tested[-1].strength_ratio)
            when = duration(tested[-1].seconds)
            parts.append(f"{HOLDINGS[other.hold].part} {kept} after {when}")
    return f"Held in another way, it keeps less or more: {', '.join(parts)}." if parts else ""


def until_it_gives_way(alloys: Iterable[AlloyResult]) -> str:
    """How far the tests went, in words: whether each solid gave way, or some, or none."""
    states = [i.tensile.get("status", "") for a in alloys for i in a.immersions if i.tensile]
    gave = [state in ("past_peak", "severed", "fully_corroded") for state in states]
    if gave and all(gave):
        return " until it gives way"
    return ", some until they give way" if any(gave) else ""


def _last_time(alloy: AlloyResult) -> str:
    time = column(alloy.history, "time")
    return duration(alloy.immersions[-1].seconds if time is None else float(time[-1]))


def half_strength_time(alloy: AlloyResult) -> float | None:
    """Time (s) at which the strength left passes one half, linear between computed times."""
    known = [i for i in alloy.immersions if i.strength_ratio is not None]
    tested = [(i.seconds, i.strength_ratio) for i in known]
    for (t0, r0), (t1, r1) in zip(tested, tested[1:], strict=False):
        if r0 > 0.5 >= r1:
            return t0 + (r0 - 0.5) / (r0 - r1) * (t1 - t0)
    return None


def duration(seconds: float, rough: bool = False) -> str:
    """A time in words in the unit in which it is a whole number; `rough` rounds it."""
    if seconds == 0:
        return "0 weeks"
    for name, unit in (("week", 604800.0), ("day", 86400.0), ("hour", 3600.0)):
        count = seconds / unit
        whole = abs(count - round(count)) < 1e-6
        if whole or (rough and count >= 2):
            return f"{round(count)} {name}{'' if round(count) == 1 else 's'}"
    return f"{seconds:.4g} seconds"


def percent(fraction: float, digits: int = 0) -> str:
    """A fraction in per cent, with more digits where it would otherwise read as none or all."""
    value = 100.0 * fraction
    if digits == 0 and (0.0 < abs(value) < 0.95 or 99.5 <= value < 100.0 - 1e-6):
        digits = 2 if abs(value) < 0.095 else 1
    return f"{value:.{digits}f} %"


def caption(item: ImmersionResult) -> str:
    """What stands below a picture of the solid: the strength left, or why there is none."""
    if item.strength_ratio is None:
        return ""
    if item.strength_ratio == 0.0 and item.summary:
        return status_in_words(item.summary.status, item.names)
    return f"{percent(item.strength_ratio)} left"


def status_in_words(text: str, names: LoadNames = LOADS["axial"]) -> str:
    """How a test ended, for a reader."""
    known = STATUS_WORDS.get(text)
    return text.replace("_", " ") if known is None else known.format(done=names.done)


def gathered(sentences: Iterable[str]) -> list[str]:
    """Join sentences that differ only in the immersion time at their end into one.

    "the test of A after 1w", "the test of A after 2w" become "the test of A after 1w, 2w".
    """
    joined: dict[str, list[str]] = {}
    for sentence in sentences:
        start, after, label = sentence.rpartition(" after ")
        joined.setdefault(start + after, []).append(label)
    return [start + ", ".join(labels) for start, labels in joined.items()]
