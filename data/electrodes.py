"""Electrodes: polarization curves of metals, as Tafel pieces, Butler-Volmer numbers or points.

Every file names the reference electrode that its potentials are against, the medium and the
temperature.  Electrodes that meet in one scene must share the reference electrode; curves whose
current falls with the potential are refused.
"""

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from . import limits
from .load import Table, path_of, read, shipped
from .schema import KINDS, Quantity, Record
from .units import UNITS, to_si

REFERENCE_ELECTRODES = ("SHE", "SCE", "Ag/AgCl (saturated KCl)", "Ag/AgCl (3 mol/L KCl)", "Hg/HgO")
LAWS = ("tafel", "piecewise_tafel", "butler_volmer", "tabulated")
BRANCHES = ("anodic", "cathodic")
_FALL = 1e-9
"""A fall of the current at a joint that is round-off, relative."""


@dataclass(frozen=True)
class TafelPiece(Record):
    """i = +- i_0 10^((E - E_0) / beta) from `starts_at` on (V; the first piece has no start).

    `published_tafel_slope` is what the source prints, where that makes a curve that falls.
    """

    current_density: Quantity  # A/m^2
    tafel_slope: Quantity  # V per decade, negative for a cathodic branch
    standard_potential: Quantity  # V
    starts_at: Quantity | None = None  # V
    published_tafel_slope: Quantity | None = None  # V per decade

    def current(self, potential: float) -> float:
        """A/m^2 at a potential (V), anodic > 0."""
        slope = self.tafel_slope.si
        decades = (potential - self.standard_potential.si) / slope
        return math.copysign(self.current_density.si, slope) * 10.0 ** min(decades, 300.0)


@dataclass(frozen=True)
class ButlerVolmer(Record):
    """Numbers of i_0 (exp(alpha_a z F eta / RT) - exp(-alpha_c z F eta / RT))."""

    exchange_current_density: Quantity  # A/m^2
    equilibrium_potential: Quantity  # V
    charge_number: Quantity
    anodic_transfer: Quantity
    cathodic_transfer: Quantity


@dataclass(frozen=True)
class PolarizationCurve(Record):
    """Points of a curve, SI: potentials (V, ascending) and current densities (A/m^2)."""

    potentials: tuple[float, ...]
    currents: tuple[float, ...]
    source: str
    where: str
    kind: str

    def sources(self) -> list[str]:
        """The source of the points."""
        return [self.source]


@dataclass(frozen=True)
class Electrode(Record):
    """How one metal polarises in one medium, against one reference electrode."""

    name: str
    title: str
    reference_electrode: str
    medium: str
    law: str
    temperature: Quantity  # K
    branch: str = ""  # of Tafel's laws
    pieces: Mapping[str, TafelPiece] = field(default_factory=dict)
    butler_volmer: ButlerVolmer | None = None
    curve: PolarizationCurve | None = None
    first_published: str = ""
    note: str = ""

    def sources(self) -> list[str]:
        """Keys of the sources used, that of the points included."""
        points = self.curve.sources() if self.curve else []
        return list(dict.fromkeys([*super().sources(), *points]))

    def as_published(self) -> "Electrode":
        """The same with the printed slopes, where others make the curve rise throughout."""
        printed = {
            name: replace(piece, tafel_slope=piece.published_tafel_slope or piece.tafel_slope)
            for name, piece in self.pieces.items()
        }
        return replace(self, pieces=printed)


def list_electrodes() -> list[str]:
    """Return the names of the shipped electrodes."""
    return list(shipped("electrodes"))


def load_electrode(name: str | Path) -> Electrode:
    """Return an electrode by its name, or from a .toml file of one's own.

    Raises ValueError for an unknown name or whatever is wrong in the file (unknown keys, missing
    units, a slope of the wrong sign, a current that falls), FileNotFoundError without such a file.
    """
    file = read(path_of("electrodes", "electrode", name))
    law = file.text("law", allowed=LAWS)
    parts: dict[str, object] = {}
    if law in ("tafel", "piecewise_tafel"):
        branch = file.text("branch", allowed=BRANCHES)
        parts = {"branch": branch, "pieces": _pieces(file, law, branch)}
    elif law == "butler_volmer":
        table = file.table("butler_volmer")
        parts = {"butler_volmer": ButlerVolmer(**table.quantities(limits.BUTLER_VOLMER))}
        table.done()
    else:
        parts = {"curve": _curve(file.table("curve"))}
    electrode = Electrode(
        name=file.text("name"),
        title=file.text("title"),
        reference_electrode=file.text("reference_electrode", allowed=REFERENCE_ELECTRODES),
        medium=file.text("medium"),
        law=law,
        first_published=file.source_or_none("first_published"),
        note=file.text("note", default=""),
        **file.quantities(limits.ELECTRODE),
        **parts,
    )
    file.done()
    return electrode


def common_reference(electrodes: Iterable[Electrode]) -> str:
    """Return the one reference electrode of all; ValueError that names two that differ."""
    given = list(electrodes)
    if not given:
        raise ValueError("electrodes: none is given; one at least is needed")
    for other in given[1:]:
        if other.reference_electrode != given[0].reference_electrode:
            raise ValueError(
                f"electrodes: '{given[0].name}' is against {given[0].reference_electrode} and "
                f"'{other.name}' against {other.reference_electrode}; all must be against one"
            )
    return given[0].reference_electrode


def _pieces(file: Table, law: str, branch: str) -> dict[str, TafelPiece]:
    pieces = {}
    for name, table in file.tables("pieces").items():
        piece = TafelPiece(**table.quantities(limits.TAFEL_PIECE, limits.TAFEL_PIECE_OPTIONAL))
        for slope in filter(None, (piece.tafel_slope, piece.published_tafel_slope)):
            if (slope.si > 0) != (branch == "anodic") or slope.si == 0:
                sign = "positive" if branch == "anodic" else "negative"
                raise table.fail(
                    "tafel_slope", f"is {slope}; a slope of the {branch} branch must be {sign}"
                )
        if (piece.starts_at is None) != (not pieces):
            must = "must not be given for the first piece" if not pieces else "is missing"
            raise table.fail("starts_at", must)
        table.done()
        pieces[name] = piece
    if law == "tafel" and len(pieces) > 1:
        raise file.fail("pieces", f"has {len(pieces)}; law 'tafel' takes one")
    for (below, first), (above, second) in itertools.pairwise(pieces.items()):
        assert second.starts_at is not None
        joint = second.starts_at.si
        if first.starts_at is not None and not joint > first.starts_at.si:
            raise file.fail("pieces", f"'{below}' and '{above}' must start in ascending order")
        low, high = first.current(joint), second.current(joint)
        if high < low - _FALL * abs(low):
            raise file.fail(
                "pieces",
                f"make the current fall at {joint:g} V from {low:.5g} ('{below}') to {high:.5g} "
                f"A/m^2 ('{above}'); it must not fall with the potential",
            )
    return pieces


def _curve(table: Table) -> PolarizationCurve:
    potentials = _column(table, "potential", "electric potential")
    currents = _column(table, "current_density", "current density")
    if len(potentials) != len(currents) or len(potentials) < 2:
        raise table.fail(
            "current_density",
            f"has {len(currents)} numbers and potential {len(potentials)}; both must have as many, "
            "two at least",
        )
    points = zip(potentials, currents, strict=True)
    for (e, i), (later, other) in itertools.pairwise(points):
        if not later > e:
            raise table.fail("potential", f"goes from {e:g} V to {later:g} V; it must ascend")
        if other < i:
            raise table.fail(
                "current_density",
                f"falls from {i:g} A/m^2 at {e:g} V to {other:g} A/m^2 at {later:g} V; it must "
                "not fall with the potential",
            )
    curve = PolarizationCurve(
        potentials=tuple(potentials),
        currents=tuple(currents),
        source=table.source("source"),
        where=table.text("where"),
        kind=table.text("kind", allowed=tuple(KINDS)),
    )
    table.done()
    return curve


def _column(table: Table, key: str, dimension: str) -> list[float]:
    """A list of finite numbers in SI; its unit stands under `key`_unit."""
    values = table.numbers(key)
    unit = table.text(f"{key}_unit", allowed=tuple(UNITS[dimension]))
    return [to_si(value, unit, dimension) for value in values]
