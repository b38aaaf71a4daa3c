"""Polarization laws: current density of an electrode by its potential, and its slope.

Every law has `current(potential)` (A/m^2, anodic > 0) and `slope(potential)` (A/(m^2 V)), arrays
of the potential's shape, the slope the exact derivative of the current and never negative, so that
a potential problem with these laws as its boundary conditions has one solution.  The potential E
is metal minus liquid, V, against one reference electrode.
"""

from peri.corrosion.polarization.butler_volmer import ButlerVolmerCurve
from peri.corrosion.polarization.law import PolarizationLaw, PolarizedRate
from peri.corrosion.polarization.piecewise_tafel import PiecewiseTafelCurve
from peri.corrosion.polarization.tabulated import TabulatedCurve
from peri.corrosion.polarization.tafel import TafelCurve

POLARIZATION: dict[str, type[PolarizationLaw]] = {
    "tafel": TafelCurve,
    "piecewise_tafel": PiecewiseTafelCurve,
    "butler_volmer": ButlerVolmerCurve,
    "tabulated": TabulatedCurve,
}
"""Laws by the name that data files give them."""

__all__ = [
    "POLARIZATION",
    "ButlerVolmerCurve",
    "PiecewiseTafelCurve",
    "PolarizationLaw",
    "PolarizedRate",
    "TabulatedCurve",
    "TafelCurve",
]
