"""Permittivity of water, for the closure `poisson`."""

import numpy as np

VACUUM_PERMITTIVITY = 8.8541878128e-12
"""F/m, CODATA 2018."""

RELATIVE_PERMITTIVITY = {298.15: 78.4, 310.15: 74.2}
"""Of water, by temperature in K."""


def permittivity_of_water(temperature: float) -> float:
    """F/m at a temperature in K, linear between the two known ones."""
    known = sorted(RELATIVE_PERMITTIVITY.items())
    relative = np.interp(temperature, [t for t, _ in known], [v for _, v in known])
    return VACUUM_PERMITTIVITY * float(relative)
