"""The ions that a couple's metals give to the liquid: transport, salt, and what they conduct.

    dT_i/dt = D sum_j w_ij (C_j - C_i) + s_i,     C = min(T, C_sat)

over liquid nodes: T what a node holds of the metals, C what of it is dissolved, the rest salt; s
what patches give, along the bonds that carry their current.  Ions diffuse (with the conduction
along walls of engine.walls); that the current moves them, too, and their diffusion potential are
left to the Nernst-Planck march (coupled.degradation).  A step is one of backward Euler: C never
falls below zero, and whether a node has salt follows from its end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from peri.engine.influence import Stencil
from peri.engine.lattice import Lattice
from peri.engine.operators import Convolution, NonlocalSum, Operator
from peri.engine.solvers import ConvergenceError, LinearSystem
from peri.engine.walls import Walls, WithWalls
from peri.transport.potential.conductivity import ConductivityLaw
from peri.transport.potential.pools import label_pools

_ROUNDS = 200
"""Of nodes that gain or lose their salt within a step; the set only grows or shrinks towards its
end (the matrix has no positive entry beside its diagonal), a few layers a round."""
_TOLERANCE = 1e-12
"""Residual of a step's linear solution, relative to what drives each pool of liquid."""
_OPEN = 1e-9
"""Of a pool's ions: the largest rest of its balance that is taken for the solver's; the solver
leaves at most 3e-11 (1,000 random scenes, tests/extreme)."""
_NONE = 1e-200
"""mol/m^3: a pool that holds no more in all its nodes is empty; liquid that is renewed again and
again comes there, whose numbers would lose their digits."""


@dataclass(frozen=True)
class Ions:
    """The metals' ions in a couple's liquid.

    Parameters
    ----------
    diffusivity : D, m^2/s, > 0.
    conductivity : law of the ions' concentration (transport.potential.conductivity).
    saturation_concentration : C_sat, mol/m^3, > 0; what is above it is salt, which stays where it
        fell out until the liquid there has room.  Without it there is none.
    renewed : bool array of the lattice's shape, optional
        Liquid that holds no ions, whatever it receives; elsewhere the lattice's edges are closed.

    Raises
    ------
    ValueError
        For numbers out of range.
    """

    diffusivity: float
    conductivity: ConductivityLaw
    saturation_concentration: float | None = None
    renewed: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in ("diffusivity", "saturation_concentration"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"ions: {name} is {value}; it must be finite and positive")

    def check(self, shape: tuple[int, ...], clean: float | np.ndarray) -> None:
        """ValueError for ions that do not fit a scene's lattice and its clean liquid, S/m."""
        if np.ndim(clean):
            raise ValueError("ions: conductivity is a field; with ions it is that of clean liquid")
        here = float(self.conductivity.of(np.zeros(1))[0])
        if not math.isclose(here, float(clean), rel_tol=1e-9):
            raise ValueError(
                f"ions: {here:g} S/m without any by their law; the liquid's conductivity, "
                f"{float(clean):g} S/m, must be the same"
            )
        if self.renewed is not None and self.renewed.shape != shape:
            raise ValueError(f"ions: renewed is of {self.renewed.shape}; the lattice has {shape}")

    def dissolved(self, content: np.ndarray) -> np.ndarray:
        """C of what nodes hold, mol/m^3."""
        return np.minimum(content, self.saturation_concentration or np.inf)

    def conducts(self, content: np.ndarray) -> np.ndarray:
        """kappa of what nodes hold, S/m, of the same shape."""
        return self.conductivity.of(self.dissolved(content))


class IonTransport:
    """The ions of a couple on its lattice; liquid by liquid.

    Parameters
    ----------
    ions : Ions
    lattice : Lattice
    stencil : Stencil
        Of unit diffusivity.
    """

    def __init__(self, ions: Ions, lattice: Lattice, stencil: Stencil) -> None:
        self.ions, self.volume = ions, lattice.cell_volume
        self.extent = float(np.linalg.norm(np.multiply(lattice.shape, lattice.spacing)))
        self.sum = NonlocalSum(stencil, lattice.shape)
        self._liquid, self._walls = b"", Walls(self.sum)
        self._bonds: Convolution | None = None
        self._pool = np.zeros(self.sum.padded_shape, int)

    def _of_liquid(self, liquid: np.ndarray) -> None:
        """Bonds and pools of the present liquid, bool of the lattice's shape."""
        mark = np.packbits(liquid).tobytes()
        if mark == self._liquid:
            return
        self._walls.update(liquid, self.ions.diffusivity * np.ones(liquid.shape))
        self._bonds = self._between(self.sum.pad(liquid), self.sum.pad(liquid))
        self._pool = self.sum.pad(label_pools(self.sum, liquid)).astype(int)
        self._liquid = mark

    def _between(self, unknown: np.ndarray, there: np.ndarray) -> Convolution:
        return Convolution(
            self.sum, unknown, there, coefficient=self.ions.diffusivity, symmetric=True
        )

    def _in_pools(self, values: np.ndarray) -> np.ndarray:
        """Sums of a padded array by pool, the first of what is no liquid."""
        return np.bincount(self._pool.ravel(), values.ravel(), int(self._pool.max()) + 1)

    def _brought(self, above: np.ndarray) -> np.ndarray:
        """What bonds bring a node at zero from nodes that are above by so much, mol/(m^3 s)."""
        assert self._bonds is not None
        gain = self._bonds.gain(above, np.zeros(self.sum.padded_shape))
        return self._walls.gain(above, gain)

    def step(
        self, content: np.ndarray, given: np.ndarray | None, liquid: np.ndarray, step: float
    ) -> tuple[np.ndarray, float]:
        """What nodes hold after a step, mol/m^3, and what has left in renewed liquid, mol.

        Conserved to round-off in each pool of liquid: content + given before is content + left
        after, each part times what the solver leaves of their sum (1 within _OPEN).  None of it
        is negative.

        Parameters
        ----------
        content : mol/m^3, of the lattice's shape, 0 off the liquid.
        given : (padded nodes,), mol: what patches give in the step; None: nothing.
        liquid : bool, of the lattice's shape.
        step : s.

        Raises ConvergenceError.
        """
        self._of_liquid(liquid)
        ions, pad = self.ions, self.sum.pad
        open_to = np.zeros(liquid.shape, bool) if ions.renewed is None else ions.renewed & liquid
        fixed, wet = pad(open_to) > 0, pad(liquid) > 0
        most = ions.saturation_concentration or np.inf
        offered = pad(content)
        if given is not None:
            offered += given.reshape(offered.shape) / self.volume
        offered *= (self._in_pools(offered) > _NONE)[self._pool]
        salt = (pad(content) > most) & ~fixed
        guess = np.minimum(pad(content), most)
        for _ in range(_ROUNDS):
            # Counted from C_sat where there is salt: long steps multiply no round-off of that.
            level = np.where(self._in_pools(salt) > 0, most, 0.0)[self._pool]
            above = self._solve(
                wet & ~fixed & ~salt, np.where(fixed, -level, 0.0), guess - level,
                (offered - level) / step, 1.0 / step,
            )  # fmt: skip
            # Far from all ions the exact solution is less than the solver's rest, of either sign.
            above = np.maximum(above, -level)
            dissolved = level + above
            after = np.where(fixed, offered + step * self._brought(dissolved), dissolved)
            if salt.any():
                after[salt] = (offered + step * self._brought(above))[salt]
            full = (after > most) & ~fixed
            if (full == salt).all():
                break
            salt, guess = full, np.minimum(dissolved, most)
        else:
            raise ConvergenceError(f"ions: where salt is does not settle in {_ROUNDS} rounds")
        after *= self._closing(offered, after)[self._pool]
        left = self.volume * float(after[fixed].sum())
        after[fixed] = 0.0
        return self.sum.crop(after), left

    def _closing(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """By pool: its ions before a step over those after, which the solver's rest keeps from 1.

        Raises ConvergenceError where more than that is open.
        """
        old, new = self._in_pools(before), self._in_pools(after)
        ratio = np.where(old > 0, old, 1.0) / np.where(old > 0, new, 1.0)
        rest = float(np.abs(ratio - 1.0).max())
        if not rest <= _OPEN:
            raise ConvergenceError(f"ions: {rest:.3g} of a pool's is open; a shorter step will do")
        return ratio

    def highest(self, rate: np.ndarray, liquid: np.ndarray, time: float) -> float:
        """Bound of C after `time` (s) of sources that never exceed `rate`, mol/s (padded nodes,).

        (1 / t + A)^-1 s is the mean of what a steady source gives, weighed by exp(-t' / t), of
        which that at t is at most e times as much; in mol/m^3, of liquid that had none.
        """
        self._of_liquid(liquid)
        open_to = np.zeros(liquid.shape, bool) if self.ions.renewed is None else self.ions.renewed
        unknown = self.sum.pad(liquid & ~open_to) > 0
        right = rate.reshape(self.sum.padded_shape) / self.volume
        nothing = np.zeros(self.sum.padded_shape)
        found = self._solve(unknown, nothing, nothing, unknown * right, 1.0 / time)
        reached = float(np.e * found.max(initial=0.0))
        return min(reached, self.ions.saturation_concentration or np.inf)

    def _solve(
        self,
        unknown: np.ndarray,
        held: np.ndarray,
        guess: np.ndarray,
        right: np.ndarray,
        shift: float,
    ) -> np.ndarray:
        """C of (shift + A) C = right on the unknown nodes, `held` on the others.

        The mean of a pool that is all unknown follows at once, since A leaves it as it is; A has
        a term of that pool's mean in addition, which the solution around it does not see.
        """
        if not unknown.any():
            return held
        assert self._bonds is not None
        bonds: Operator = self._between(unknown.astype(float), self._bonds.right)
        operator = WithWalls(bonds, self._walls)
        free = self._in_pools(unknown)
        closed = (free > 0) & (free == self._in_pools(self._bonds.right))
        share = np.where(closed, 1.0 / np.maximum(free, 1.0), 0.0)
        slowest = self.ions.diffusivity * (np.pi / self.extent) ** 2

        def mean(values: np.ndarray) -> np.ndarray:
            return (share * self._in_pools(unknown * values))[self._pool]

        def hold(u: np.ndarray, y: np.ndarray) -> float:
            level = mean(u)
            y += slowest * level
            return slowest * float(np.vdot(u, level))

        stored = shift * unknown
        # The preconditioner has it everywhere: it does not see bonds that join parts at corners.
        rows = np.maximum(operator.row_sums(), 0.0) + stored + slowest * unknown
        system = LinearSystem(
            operator,
            shift=stored,
            sink=rows,
            extra=hold if closed.any() else None,
            extra_diagonal=slowest * share[self._pool],
        )
        b = unknown * (right + operator.gain(held, np.zeros(self.sum.padded_shape)))
        level = mean(b)
        b = b - level
        # Pools know nothing of each other: each is solved to its own size.
        size = self._sizes(b)[self._pool]
        scale = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 0.0)
        b, u = scale * b, scale * unknown * (guess - mean(guess))
        # In a long step what there was can be far more than what is to come, its round-off, too.
        worse = self._in_pools(system.residual(u, b) ** 2) > self._in_pools(b**2)
        u = np.where(worse[self._pool], 0.0, u)
        system.solve(u, system.residual(u, b), _TOLERANCE)
        return held + level / shift + size * u

    def _sizes(self, values: np.ndarray) -> np.ndarray:
        """By pool: the norm of a padded array.

        Squares of what is scaled, since a pool may hold 1e-200 of what another does.
        """
        scale = self._in_pools(np.abs(values))
        scale = np.where(scale > 0, scale, 1.0)
        return scale * np.sqrt(self._in_pools((values / scale[self._pool]) ** 2))
