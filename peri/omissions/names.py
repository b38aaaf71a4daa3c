"""Names of what a march of corrosion may leave out; read without the solvers."""

LIQUID = "liquid"
SOLID_CORE = "solid_core"
FAR_LIQUID = "far_liquid"
COARSE_LIQUID = "coarse_liquid"
OMITTABLE = (LIQUID, FAR_LIQUID)
"""What may be refused; the metal's core has no unknowns in any march, coarse liquid is none yet."""
