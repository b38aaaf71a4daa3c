"""Other records of an alloy's hardening than the one in its own file, to see what they change."""

from dataclasses import dataclass
from pathlib import Path

from . import limits
from .load import path_of, read, shipped
from .schema import Quantity, Record

_NUMBERS = ("yield_stress", "ultimate_tensile_strength", "uniform_strain")


@dataclass(frozen=True)
class HardeningRecord(Record):
    """Three numbers that a hardening curve of an alloy is fitted through, as in an `Alloy`."""

    name: str
    title: str
    alloy: str
    yield_stress: Quantity  # Pa
    ultimate_tensile_strength: Quantity  # Pa, engineering stress at maximum force
    uniform_strain: Quantity  # engineering strain at maximum force
    note: str = ""


def list_hardening(alloy: str | None = None) -> list[str]:
    """Return the names of the shipped records, all or those of one alloy."""
    names = list(shipped("hardening"))
    return [name for name in names if alloy is None or load_hardening(name).alloy == alloy]


def load_hardening(name: str | Path) -> HardeningRecord:
    """Return a record by its name, or from a .toml file of one's own.

    Raises ValueError for an unknown name or whatever is wrong in the file, FileNotFoundError
    without such a file.
    """
    file = read(path_of("hardening", "hardening", name))
    record = HardeningRecord(
        name=file.text("name"),
        title=file.text("title"),
        alloy=file.text("alloy"),
        note=file.text("note", default=""),
        **file.quantities({key: limits.ALLOY[key] for key in _NUMBERS}),
    )
    file.done()
    if record.ultimate_tensile_strength.si <= record.yield_stress.si:
        raise ValueError(
            f"{file.file}: ultimate_tensile_strength is {record.ultimate_tensile_strength}; it "
            f"must be above yield_stress, {record.yield_stress}"
        )
    return record
