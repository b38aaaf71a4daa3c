"""Choices of a stencil by name; read without NumPy.

What each means is said where it is chosen, in engine.influence.diffusion_stencil.
"""

CALIBRATIONS = ("discrete", "closed", "as_published")
INFLUENCES = ("constant", "linear")
