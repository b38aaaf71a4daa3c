"""Corrosion models on the nonlocal engine."""

from peri.corrosion.run import CorrosionResult, corrode
from peri.corrosion.scene import CorrosionScene

__all__ = ["CorrosionResult", "CorrosionScene", "corrode"]
