"""The material at a point, in plain NumPy and Numba: no mesh, no solver."""

from fem.constitutive.hardening import Hardening, VoceHardening, fit_voce
from fem.constitutive.hardening_fit import HardeningFit, fit_from_csv
from fem.constitutive.material import Material

__all__ = [
    "Hardening",
    "HardeningFit",
    "Material",
    "VoceHardening",
    "fit_from_csv",
    "fit_voce",
]
