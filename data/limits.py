"""The dimension of every quantity a data file may hold, and the range it must lie in (SI)."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Dimension and range of a quantity; the ends belong to the range unless `open_` says no."""

    dimension: str
    lowest: float = -math.inf
    highest: float = math.inf
    open_lowest: bool = False
    open_highest: bool = False

    def hold(self, value: float) -> bool:
        """Return whether a value in SI is finite and within the range."""
        above = value > self.lowest if self.open_lowest else value >= self.lowest
        below = value < self.highest if self.open_highest else value <= self.highest
        return math.isfinite(value) and above and below

    def __str__(self) -> str:
        parts = []
        if math.isfinite(self.lowest):
            parts.append(f"{'above' if self.open_lowest else 'at least'} {self.lowest:g}")
        if math.isfinite(self.highest):
            parts.append(f"{'below' if self.open_highest else 'at most'} {self.highest:g}")
        return " and ".join(parts) or "a finite number"


def _above_zero(dimension: str, highest: float = math.inf) -> Limits:
    return Limits(dimension, 0.0, highest, open_lowest=True)


TEMPERATURE = Limits("temperature", 273.15, 373.15)
MASS_FRACTION = Limits("dimensionless", 0.0, 1.0, open_lowest=True, open_highest=True)

ELEMENT = {
    "density": _above_zero("density", 25e3),
    "molar_mass": _above_zero("molar mass", 0.3),
}

LARGEST_YIELD_STRAIN = 0.05
"""Yield stress over Young modulus; metals lie below 0.02, more is a slip in a unit."""

ALLOY = {
    "charge_number": Limits("dimensionless", 1, 4),
    "young_modulus": _above_zero("pressure", 1e12),
    # 0.5 is incompressible: the bulk modulus E / (3 (1 - 2 nu)) would be infinite.
    "poisson_ratio": Limits("dimensionless", -1.0, 0.5, open_lowest=True, open_highest=True),
    "yield_stress": _above_zero("pressure", 1e10),
    "ultimate_tensile_strength": _above_zero("pressure", 1e10),
    "uniform_strain": _above_zero("dimensionless", 2.0),
    "q1": Limits("dimensionless", 1.0, 3.0),
}
ALLOY_OPTIONAL = {"published_solid_concentration": _above_zero("concentration", 3e5)}

SPECIES = {
    "charge_number": Limits("dimensionless", -4, 4),
    "total_concentration": Limits("concentration", 0.0, 1e4),
}

SPECIES_DIFFUSIVITY = _above_zero("diffusivity", 1e-6)
ION_SIZE = _above_zero("length", 5e-9)
STRENGTH_COEFFICIENT = Limits("molar volume", -1e-3, 1e-3)
LOG_K = Limits("dimensionless", -300, 300)
MOLAR_VOLUME = _above_zero("molar volume", 1e-2)
RATE_CONSTANT = _above_zero("surface reaction rate", 1e3)
SPECIFIC_SURFACE = _above_zero("specific surface", 1e9)
NUCLEATION_INDEX = Limits("dimensionless", 0, 100)
ADSORPTION_CONSTANT = _above_zero("molar volume", 1e9)
EFFICIENCY = Limits("dimensionless", 0.0, 1.0, open_lowest=True)

MEDIUM = {"temperature": TEMPERATURE}
MEDIUM_OPTIONAL = {
    "carbon_dioxide": Limits("dimensionless", 0.0, 1.0),
    "refresh_interval": _above_zero("time"),
    "bath_volume": _above_zero("volume", 1.0),
}

PUBLISHED_LOSS = {
    "degradation_rate": _above_zero("degradation rate", 1e-6),
    "mass_loss": Limits("dimensionless", 0.0, 1.0),
    "after": _above_zero("time"),
}

_POTENTIAL = Limits("electric potential", -10, 10)
ELECTRODE = {"temperature": TEMPERATURE}
TAFEL_PIECE = {
    "current_density": _above_zero("current density", 1e8),
    "tafel_slope": _POTENTIAL,
    "standard_potential": _POTENTIAL,
}
TAFEL_PIECE_OPTIONAL = {"starts_at": _POTENTIAL, "published_tafel_slope": _POTENTIAL}
BUTLER_VOLMER = {
    "exchange_current_density": _above_zero("current density", 1e8),
    "equilibrium_potential": _POTENTIAL,
    "charge_number": Limits("dimensionless", 1, 4),
    "anodic_transfer": _above_zero("dimensionless", 2),
    "cathodic_transfer": _above_zero("dimensionless", 2),
}

CALIBRATION_SCENE = {
    "diameter": _above_zero("length", 1.0),
    "height": _above_zero("length", 1.0),
    "nodes": Limits("dimensionless", 1),
    "spacing": _above_zero("length", 0.01),
    "horizon_ratio": Limits("dimensionless", 1, 8),
}
CALIBRATION_SCENE_OPTIONAL = {"area_factor": _above_zero("dimensionless", 10)}

CORROSION_PARAMETERS = {
    "interface_diffusivity": _above_zero("diffusivity", 1e-4),
    "liquid_diffusivity": _above_zero("diffusivity", 1e-4),
    "saturation_concentration": _above_zero("concentration", 3e5),
    "volume_loss_scale": _above_zero("dimensionless", 1e6),
    "kernel_exponent": Limits("dimensionless", 0.0, 1.0, open_highest=True),
    "solid_concentration": _above_zero("concentration", 3e5),
}
