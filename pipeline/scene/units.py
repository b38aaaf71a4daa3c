"""Units that a person types or reads, of the table in `data`; everything else is SI."""

import math
import re
from dataclasses import dataclass
from decimal import Decimal

from perilife_data.units import UNITS

SECONDS_PER = UNITS["time"]
"""Time units accepted on the command line and their length in seconds."""

METRES_PER = UNITS["length"]
"""Length units accepted for solids from a file and their length in metres."""

_VOLUMES = {name: size for name, size in UNITS["volume"].items() if name.isalpha()}
"""Volume units accepted on the command line and their size in cubic metres."""

RADIANS_PER = UNITS["angle"]
"""Angle units accepted on the command line and their size in radians."""

_TIME = re.compile(r"([+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)\s*([a-zA-Z]*)", re.ASCII)


@dataclass(frozen=True)
class ImmersionTime:
    """One immersion time: the text the person typed (it names a folder) and seconds."""

    label: str
    seconds: float

    @property
    def days(self) -> float:
        """The same time in days."""
        return self.seconds / SECONDS_PER["d"]


def parse_time(text: str, field: str = "immersion time") -> ImmersionTime:
    """Read a time such as `8w`, `56d`, `36h`, `90min` or `30s`.

    Raises ValueError with one sentence when the number, the unit or the sign is wrong.
    """
    allowed = ", ".join(SECONDS_PER)
    match = _TIME.fullmatch(text.strip())
    if match is None or match.group(2) not in SECONDS_PER:
        raise ValueError(
            f"{field} '{text}' is not understood; give a number and a unit out of "
            f"{allowed}, for example 8w, 56d or 36h"
        )
    seconds = _in_si(match.group(1), SECONDS_PER[match.group(2)])
    _refuse_negative(match.group(1), text, field)
    if not math.isfinite(seconds):
        raise ValueError(f"{field} '{text}' is infinite; it must be a finite time")
    return ImmersionTime(label=text.strip().replace(" ", ""), seconds=seconds)


def parse_immersion_times(texts: list[str] | tuple[str, ...]) -> tuple[ImmersionTime, ...]:
    """Read a list of immersion times that must rise strictly.

    Raises ValueError with one sentence for an empty list, a wrong or negative time, times
    that fall, or one time given twice (also in two spellings, such as `7d` and `1w`).
    """
    if not texts:
        raise ValueError("no immersion time was given; give at least one, for example 8w")
    times = tuple(parse_time(text) for text in texts)
    for earlier, later in zip(times, times[1:], strict=False):
        if math.isclose(later.seconds, earlier.seconds, rel_tol=1e-9):
            raise ValueError(
                f"immersion times {earlier.label} and {later.label} are the same time; "
                "each must be given once"
            )
        if later.seconds < earlier.seconds:
            raise ValueError(
                f"immersion time {later.label} comes after {earlier.label}; "
                "the times must rise from left to right"
            )
    return times


def metres(value: float, unit: str, field: str = "length") -> float:
    """Convert `value` in `unit` to metres; ValueError names the units that are known."""
    if unit not in METRES_PER:
        raise ValueError(
            f"unit '{unit}' of {field} is not known; it must be one of {', '.join(METRES_PER)}"
        )
    return value * METRES_PER[unit]


def format_seconds(seconds: float) -> str:
    """Write a run time for a reader: `0.8 s`, `42 s`, `3 min 12 s`, `2 h 05 min`."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def format_bytes(count: float) -> str:
    """Write a size for a reader: `512 B`, `3.4 MB`, `1.2 GB` (powers of 1000)."""
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count:.0f} B"


def format_length(value: float) -> str:
    """Write a length in metres for a reader, in um or mm."""
    return f"{value * 1e6:.4g} um" if abs(value) < 1e-3 else f"{value * 1e3:.4g} mm"


_QUANTITY = re.compile(r"([+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)\s*([a-zA-Z]+)?", re.ASCII)


def parse_angle(text: str, field: str = "angle") -> float:
    """Read an angle such as `30deg` or `0.5rad` and return radians.

    Raises ValueError with one sentence when the number or the unit is missing or wrong.
    """
    return _parse(text, field, RADIANS_PER, "30deg")[1]


def parse_in(text: str, field: str, units: dict[str, float], example: str) -> float:
    """Read a number with one of these units (unit -> its size in SI) and return it in SI.

    Raises ValueError with one sentence when the number or the unit is missing or wrong.
    """
    return _parse(text, field, units, example)[1]


def parse_volume(text: str, field: str = "volume") -> float:
    """Read a volume such as `50mL` or `0.2L` and return cubic metres.

    Raises ValueError with one sentence when the number or the unit is missing or wrong, or the
    volume is not above 0.
    """
    number, volume = _parse(text, field, _VOLUMES, "50mL or 0.2L")
    _refuse_negative(number, text, field)
    if volume == 0:
        raise ValueError(f"{field} '{text}' is 0; it must be above 0")
    return volume


def parse_length(text: str, field: str = "length") -> float:
    """Read a length such as `2mm` or `100um` and return metres.

    Raises ValueError with one sentence when the number or the unit is missing or wrong, or the
    length negative.
    """
    number, metres = _parse(text, field, METRES_PER, "2mm or 100um")
    _refuse_negative(number, text, field)
    return metres


def _refuse_negative(number: str, text: str, field: str) -> None:
    if number.startswith("-"):
        raise ValueError(f"{field} '{text}' is negative; it must be at least 0")


def _in_si(number: str, factor: float) -> float:
    """A typed number times the size of its unit, rounded once: 300um is 0.3mm to the last bit."""
    try:
        return float(Decimal(number) * Decimal(repr(factor)))
    except ArithmeticError:  # an exponent beyond all bounds
        return math.inf


def _parse(text: str, field: str, units: dict[str, float], example: str) -> tuple[str, float]:
    """The number as typed, and the quantity in the SI unit."""
    match = _QUANTITY.fullmatch(text.strip())
    if match is None or match.group(2) not in units:
        raise ValueError(
            f"{field} '{text}' is not understood; give a number and a unit out of "
            f"{', '.join(units)}, for example {example}"
        )
    value = _in_si(match.group(1), units[match.group(2)])
    if not math.isfinite(value):
        raise ValueError(f"{field} '{text}' is infinite; it must be finite")
    return match.group(1), value
