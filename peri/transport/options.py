"""How the ions of a liquid are solved for."""

from __future__ import annotations

from dataclasses import dataclass

from peri.transport.fluxes import FLUX_FORMS

CLOSURES = ("electroneutral", "poisson", "as_published", "none")


@dataclass(frozen=True)
class TransportOptions:
    """How the liquid is solved.

    flux_form : see fluxes.py
    closure : "electroneutral" (default), "poisson" (with water's permittivity), "as_published"
        (2.61, 2.64: the printed conductivity in the place of a permittivity), or "none": no
        potential; the charge that diffusion separates is then taken up by an inert ion.
    tolerance : residual norm of every component, relative to that of the release
    neutrality : net charge at which the sweeps for the potential end, relative to the ionic
        strength
    """

    flux_form: str = "sqra"
    closure: str = "electroneutral"
    tolerance: float = 1e-10
    neutrality: float = 1e-12

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("flux_form", self.flux_form, FLUX_FORMS),
            ("closure", self.closure, CLOSURES),
        ):
            if value not in allowed:
                raise ValueError(f"{name}: '{value}'; allowed are {', '.join(allowed)}")
        for name, number in (("tolerance", self.tolerance), ("neutrality", self.neutrality)):
            if not 0 < number < 1:
                raise ValueError(f"{name}: {number}; it must be between 0 and 1")
