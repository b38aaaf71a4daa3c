"""What the data files hold: a quantity with its provenance, and the records made of quantities.

Every record is frozen and is made by load.py, which checks it; a record built by hand is not
checked. All dimensions are stated with each field; `.si` is the number that models use.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

from .units import to_si

KINDS: dict[str, str] = {
    "measured": "the result of an experiment",
    "fitted": "fitted to an experiment or to other data",
    "not_identified": "held in a fit whose data do not determine it",
    "assumed": "chosen by this project, because no source gives it",
    "published": "printed in the source",
    "published_uncorrected": "printed in the source and known to be wrong; kept for comparison",
    "derived": "computed from other quantities of known source",
}
"""Kinds of quantities and what each means."""

TO_BE_REPORTED = ("assumed", "fitted", "not_identified")
"""The kinds that a report lists one by one."""
TO_BE_LISTED = (*TO_BE_REPORTED, "published_uncorrected")
"""The kinds that the list of a run has one by one where the run uses them."""


@dataclass(frozen=True)
class Quantity:
    """A number as its source gives it, with unit, source and kind.

    `source` is a key of references.bib (empty for what is derived here), `where` the table,
    equation or section in it, `conditions` what the number holds for.
    """

    value: float
    unit: str
    dimension: str
    source: str
    where: str
    kind: str
    conditions: str = ""
    note: str = ""

    @property
    def si(self) -> float:
        """The value in the SI unit of its dimension."""
        return to_si(self.value, self.unit, self.dimension)

    def __float__(self) -> float:
        return self.si

    def __str__(self) -> str:
        return f"{self.value:g}" if self.unit == "1" else f"{self.value:g} {self.unit}"


class Record:
    """Base of everything that is made of quantities: lists them by name."""

    first_published: str = ""
    """Key of the source that printed the numbers first, where that is not the source named."""

    def quantities(self) -> dict[str, Quantity]:
        """Return every quantity of the record by dotted name, in the order of the fields."""
        found: dict[str, Quantity] = {}
        for entry in fields(self):
            _collect(entry.name, getattr(self, entry.name), found)
        return found

    def assumed(self) -> dict[str, Quantity]:
        """Return the quantities that are assumed or fitted, by dotted name."""
        return {n: q for n, q in self.quantities().items() if q.kind in TO_BE_REPORTED}

    def sources(self) -> list[str]:
        """Return the keys of the sources used, each once, in order of first use."""
        used = [q.source for q in self.quantities().values()] + [self.first_published]
        return [key for key in dict.fromkeys(used) if key]


def _collect(name: str, value: object, found: dict[str, Quantity]) -> None:
    if isinstance(value, Quantity):
        found[name] = value
    elif isinstance(value, Record):
        found.update({f"{name}.{inner}": q for inner, q in value.quantities().items()})
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            _collect(f"{name}.{key}", inner, found)


@dataclass(frozen=True)
class Element(Record):
    """A chemical element as an ingredient of an alloy."""

    symbol: str
    density: Quantity  # kg/m^3
    molar_mass: Quantity  # kg/mol


@dataclass(frozen=True)
class Alloy(Record):
    """An alloy: composition, concentration of the dissolving element, mechanical data.

    `solid_concentration` (mol/m^3) is the amount of the dissolving element per volume of alloy,
    w rho / M, with the density of the mixture from 1/rho = sum_k w_k / rho_k (volumes add up).
    `published_solid_concentration` is what the source prints, where it prints one; `corrosion`
    holds constants of the alloy's own file, where it has some.
    """

    name: str
    title: str
    dissolving_element: str
    mass_fractions: Mapping[str, Quantity]  # of every element, they sum to 1
    elements: Mapping[str, Element]  # the same elements
    density: Quantity  # kg/m^3
    charge_number: Quantity  # of the dissolved ion
    solid_concentration: Quantity  # mol/m^3
    young_modulus: Quantity  # Pa
    poisson_ratio: Quantity
    yield_stress: Quantity  # Pa
    ultimate_tensile_strength: Quantity  # Pa, engineering stress at maximum force
    uniform_strain: Quantity  # engineering strain at maximum force
    q1: Quantity  # parameter of the yield function (5.40)
    published_solid_concentration: Quantity | None = None  # mol/m^3
    corrosion: "OwnCorrosion | None" = None

    @property
    def molar_mass(self) -> Quantity:
        """Molar mass of the dissolving element."""
        return self.elements[self.dissolving_element].molar_mass


@dataclass(frozen=True)
class Species(Record):
    """A dissolved species: its charge number and its total concentration in the medium."""

    charge_number: Quantity
    total_concentration: Quantity  # mol/m^3


@dataclass(frozen=True)
class Medium(Record):
    """A medium that implants are immersed in."""

    name: str
    title: str
    temperature: Quantity  # K
    species: Mapping[str, Species]
    carbon_dioxide: Quantity | None = None  # volume fraction in the gas above the medium
    refresh_interval: Quantity | None = None  # s
    bath_volume: Quantity | None = None  # m^3 around one implant; unknown: as much as is needed
    reactions: str = ""  # the set of data/reactions that its species react by
    first_published: str = ""
    note: str = ""

    def net_charge(self) -> float:
        """Return sum_k z_k C_k of the totals as listed, mol/m^3 (not zero for totals)."""
        return sum(s.charge_number.si * s.total_concentration.si for s in self.species.values())


@dataclass(frozen=True)
class CalibrationScene(Record):
    """The scene a parameter set was fitted in: its result belongs to that scene."""

    solid: str
    domain: str  # "cylinder" or "ball"
    diameter: Quantity  # m
    height: Quantity  # m
    nodes: Quantity
    spacing: Quantity  # m
    horizon_ratio: Quantity  # horizon / spacing
    calibration: str  # of the stencil constants: "closed" or "discrete"
    saturation: str  # "as_published", "complementarity" or "none"
    boundary: str  # "refreshed" or "no_flux"
    area_factor: Quantity | None = None  # A_high / A_low of (5.14)


@dataclass(frozen=True)
class CorrosionParameters(Record):
    """Parameters of the bi-material model with the kinetics (5.13) for one alloy."""

    interface_diffusivity: Quantity  # D_int, m^2/s
    liquid_diffusivity: Quantity  # D_liq, m^2/s
    saturation_concentration: Quantity  # C_sat, mol/m^3
    volume_loss_scale: Quantity  # l of (5.13), dimensionless
    kernel_exponent: Quantity  # q
    solid_concentration: Quantity  # C_solid used in the fit, mol/m^3


@dataclass(frozen=True)
class OwnCorrosion(Record):
    """Constants of the bi-material model that stand in an alloy's own file, and their scene."""

    medium: str
    scene: CalibrationScene
    parameters: CorrosionParameters


@dataclass(frozen=True)
class Calibration:
    """How one alloy's parameters were fitted.

    data: the file of measurements and its sha256; measurements: how many; loss: sum of squared
    residuals over standard deviations (5.15); scatter: mean standard deviation of V_L, estimated
    from the residuals where scatter_estimated; parameters: names of what the data determine;
    samples: of their posterior, equal weights, SI, one row per sample; not_seen: sentences on the
    directions that the data do not see.
    """

    data: str
    sha256: str
    measurements: int
    loss: float
    scatter: float
    scatter_estimated: bool
    parameters: tuple[str, ...]
    samples: tuple[tuple[float, ...], ...]
    not_seen: tuple[str, ...] = ()


@dataclass(frozen=True)
class ParameterSet(Record):
    """A parameter set, published or fitted: one scene and the parameters of each alloy."""

    name: str
    title: str
    medium: str
    scene: CalibrationScene
    alloys: Mapping[str, CorrosionParameters]
    first_published: str = ""
    note: str = ""
    calibrations: Mapping[str, Calibration] = field(default_factory=dict)

    def for_alloy(self, alloy: str) -> CorrosionParameters:
        """Return the parameters of one alloy. Raises ValueError when the set has none."""
        if alloy not in self.alloys:
            raise ValueError(
                f"parameter set '{self.name}' has no alloy '{alloy}'; "
                f"it holds {', '.join(self.alloys)}"
            )
        return self.alloys[alloy]
