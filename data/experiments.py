"""Losses that others printed as numbers, to stand beside a computed one."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from . import limits
from .load import path_of, read, shipped
from .schema import Quantity, Record


@dataclass(frozen=True)
class PublishedLoss(Record):
    """One result: a degradation rate, or the share of mass lost after a time."""

    material: str
    medium: str
    degradation_rate: Quantity | None = None  # m/s
    mass_loss: Quantity | None = None
    after: Quantity | None = None  # s


@dataclass(frozen=True)
class Experiment(Record):
    """Printed losses of one study by label."""

    name: str
    title: str
    results: Mapping[str, PublishedLoss]


def list_experiments() -> list[str]:
    """Return the names of the shipped experiments."""
    return list(shipped("experiments"))


def load_experiment(name: str | Path) -> Experiment:
    """Return an experiment by its name, or from a .toml file of one's own.

    Raises ValueError for an unknown name or whatever is wrong in the file (a result without a
    rate and without a loss, a loss without its time), FileNotFoundError without such a file.
    """
    file = read(path_of("experiments", "experiment", name))
    results = {}
    text = {"name": file.text("name"), "title": file.text("title")}
    for label, table in file.tables("results").items():
        found = PublishedLoss(
            material=table.text("material"),
            medium=table.text("medium"),
            **table.quantities({}, limits.PUBLISHED_LOSS),
        )
        table.done()
        if found.degradation_rate is None and found.mass_loss is None:
            raise table.fail("degradation_rate", "is missing, and so is mass_loss; give one")
        if (found.mass_loss is None) != (found.after is None):
            raise table.fail("after", "must stand beside mass_loss, and only there")
        results[label] = found
    file.done()
    return Experiment(**text, results=results)
