"""Units that data files and the command line may use, by dimension, with their factor to SI.

The table is explicit so that a reader sees what is accepted and a file cannot pass a pressure
where a length belongs. It holds what materials data of this field are printed in; a new unit is
one line.
"""

import math

UNITS: dict[str, dict[str, float]] = {
    "dimensionless": {"1": 1.0, "%": 1e-2},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "inch": 0.0254},
    "volume": {"m^3": 1.0, "L": 1e-3, "mL": 1e-6, "uL": 1e-9},
    "time": {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "w": 604800.0},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9},
    "density": {"kg/m^3": 1.0, "g/cm^3": 1e3},
    "molar mass": {"kg/mol": 1.0, "g/mol": 1e-3},
    "concentration": {"mol/m^3": 1.0, "mmol/L": 1.0, "mol/L": 1e3},
    "diffusivity": {"m^2/s": 1.0, "cm^2/s": 1e-4, "mm^2/s": 1e-6},
    "degradation rate": {"m/s": 1.0, "mm/year": 1e-3 / (365.25 * 86400.0)},
    "molar volume": {"m^3/mol": 1.0, "L/mol": 1e-3, "cm^3/mol": 1e-6},
    "surface reaction rate": {"mol/(m^2 s)": 1.0},
    "specific surface": {"1/m": 1.0, "m^2/m^3": 1.0},
    "temperature": {"K": 1.0, "degC": 1.0},
    "electric potential": {"V": 1.0, "mV": 1e-3},
    "current density": {"A/m^2": 1.0, "mA/cm^2": 10.0, "uA/cm^2": 1e-2},
    "conductivity": {"S/m": 1.0, "mS/cm": 0.1},
    "resistance of a surface": {"ohm m^2": 1.0, "ohm cm^2": 1e-4},
}
"""Dimension -> unit -> factor to the SI unit, which is the first of each row."""

OFFSETS: dict[str, float] = {"degC": 273.15}
"""What is added to the SI value, for the units whose zero is not SI's."""


def to_si(value: float, unit: str, dimension: str) -> float:
    """Return `value` (in `unit`, of the given dimension) in SI.

    Raises ValueError when the unit does not belong to the dimension.
    """
    if unit not in UNITS[dimension]:
        raise ValueError(
            f"unit '{unit}' is not a unit of {dimension}; allowed are {', '.join(UNITS[dimension])}"
        )
    return value * UNITS[dimension][unit] + OFFSETS.get(unit, 0.0)
