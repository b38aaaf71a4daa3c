"""What migration in a potential adds to the inflow of the components of a liquid."""

from __future__ import annotations

import numpy as np

from peri.engine.solvers import ConvergenceError
from peri.transport.chemistry.species import Chemistry
from peri.transport.fluxes import migration, sqra, steps_of
from peri.transport.liquid import Held, LiquidSpace

LARGEST_EXPONENT = 690.0
"""|z| psi / 2 of the largest drop in a liquid (its edge at 0 included), of which the factors of
`sqra`, their products and these with 1e8 mol/m3 are doubles, which end at exp(709.78)."""


class Migration:
    """What migration adds to the inflow of every component of a liquid.

    Parameters
    ----------
    form : one of FLUX_FORMS
    space : LiquidSpace
    chemistry : Chemistry

    groups : Chemistry.charge_groups
    """

    def __init__(self, form: str, space: LiquidSpace, chemistry: Chemistry) -> None:
        self.form, self.space = form, space
        self.components = len(chemistry.components)
        self.groups = chemistry.charge_groups()
        # By charge number, so that only the fields of one are needed at a time.
        self._carriers: dict[float, list[tuple[int, np.ndarray, np.ndarray]]] = {}
        for e, z, weights in sorted(self.groups, key=lambda group: group[1]):
            k = np.flatnonzero(weights)
            self._carriers.setdefault(z, []).append((e, k, weights[k]))

    def mobility(self, edge: np.ndarray) -> np.ndarray:
        """sum_k nu_ke z_k D_k C_k of a composition (K,): per change of psi, (E,), mol/m/s.

        Of several (K, R) the mean.
        """
        out = np.zeros(self.components)
        for e, z, weight in self.groups:
            out[e] += z * float(np.mean(weight @ edge))
        return out

    def inflow(
        self,
        concentration: np.ndarray,
        edge: np.ndarray,
        psi: np.ndarray,
        held_psi: Held = 0.0,
    ) -> np.ndarray:
        """N_e, (E, n), mol/m3/s.

        concentration : (K, n);  psi : (n,)
        edge : (K,) or (K, R), of what is held;  held_psi : there, a number or (R,)

        Raises ConvergenceError for a potential, of a round that has lost its way, in which the
        flux of `sqra` along a bond may be no double.
        """
        space = self.space
        if self.form == "sqra":
            self._check(psi, held_psi)
        out = np.zeros((self.components, space.n))
        for z, carried in self._carriers.items():
            if self.form == "sqra":
                steps, at_held = steps_of(z, psi), steps_of(z, held_psi)
                shrunk = space.neighbours(steps[1], at_held[1])
            for e, carriers, weights in carried:
                c, at_edge = weights @ concentration[carriers], weights @ edge[carriers]
                if self.form == "sqra":
                    grown = space.neighbours(steps[0] * c, at_held[0] * at_edge)
                    around = space.neighbours(c, at_edge)
                    out[e] += sqra(c, steps, grown, around, shrunk, space.bonds)
                else:
                    fields = space.spread(c, at_edge), space.spread(psi, held_psi)
                    out[e] += space.gather(
                        migration(
                            self.form, space.sum, space.all_volume, *fields, z, space.degree_field
                        )
                    )
        return out

    def _check(self, psi: np.ndarray, held_psi: Held) -> None:
        """Refuse a drop beyond LARGEST_EXPONENT, before exp overflows."""
        drop = self.space.range(np.append(psi, held_psi))
        charge = max(map(abs, self._carriers), default=0.0)
        if not 0.5 * charge * drop <= LARGEST_EXPONENT:
            raise ConvergenceError(
                f"potential: {drop:.2g} RT/F in the liquid, of which ions of charge {charge:g} "
                "have no flux; a shorter step or a smaller current will do"
            )
