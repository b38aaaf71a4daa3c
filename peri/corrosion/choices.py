"""Choices of a scene of corrosion by name; read without the solvers.

What each means is said where it is chosen, in corrosion.scene.CorrosionScene.
"""

SATURATION_MODELS = ("complementarity", "as_published", "none")
BOUNDARIES = ("refreshed", "no_flux")
FLUX_CALIBRATIONS = ("isotropic", "axis", "every_axis")
DETACHED = ("keep", "dissolve")
CLASS_LAWS = ("proportional", "faradaic")
"""Laws of the interface that rate classes have (corrosion.classes.laws)."""
