"""The material at a point, in plain NumPy and Numba: no mesh, no solver."""

from fem.constitutive.hardening import Hardening, VoceHardening, fit_voce
from fem.constitutive.material import Material

__all__ = ["Hardening", "Material", "VoceHardening", "fit_voce"]
