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

_ROUNDS = 200
"""Of nodes that gain or lose their salt within a step; the set only grows or shrinks towards its
end (the matrix has no positive entry beside its diagonal), a few layers a round."""
_TOLERANCE = 1e-11
"""Residual of a step's linear solution; the content follows from the bonds' flow, so that what is
left open is none of the balance."""
_REST = 1e-9
"""Of the highest content: how far below 0 that leaves a node that holds nothing."""


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
        """kappa of what nodes hold, S/m, of the same shape.

        Raises ConvergenceError for a content that is negative by more than the solver's rest.
        """
        dissolved = self.dissolved(content)
        least = float(dissolved.min(initial=0.0))
        if least < -_REST * float(dissolved.max(initial=0.0)):
            raise ConvergenceError(f"ions: a node holds {least:g} mol/m^3; a shorter step will do")
        return self.conductivity.of(np.abs(dissolved))


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
        self.sum = NonlocalSum(stencil, lattice.shape)
        self._liquid, self._walls = b"", Walls(self.sum)
        self._bonds: Convolution | None = None

    def _of_liquid(self, liquid: np.ndarray) -> None:
        """Bonds of the present liquid, bool of the lattice's shape."""
        mark = np.packbits(liquid).tobytes()
        if mark == self._liquid:
            return
        self._walls.update(liquid, self.ions.diffusivity * np.ones(liquid.shape))
        self._bonds = self._between(self.sum.pad(liquid), self.sum.pad(liquid))
        self._liquid = mark

    def _between(self, unknown: np.ndarray, there: np.ndarray) -> Convolution:
        return Convolution(
            self.sum, unknown, there, coefficient=self.ions.diffusivity, symmetric=True
        )

    def _flow(self, concentration: np.ndarray) -> np.ndarray:
        """What the bonds bring every liquid node, mol/(m^3 s); padded, sums to nothing."""
        bonds = self._bonds
        assert bonds is not None
        # A level moves nothing but round-off, which long steps make large.
        wet = bonds.unknown > 0
        above = np.where(wet, concentration - concentration[wet].mean(), 0.0)
        gain = bonds.gain(above, np.zeros(self.sum.padded_shape))
        return gain - bonds.diagonal() * above + self._walls.flow(above)

    def step(
        self, content: np.ndarray, given: np.ndarray | None, liquid: np.ndarray, step: float
    ) -> tuple[np.ndarray, float]:
        """What nodes hold after a step, mol/m^3, and what has left in renewed liquid, mol.

        Conserved to round-off: content + given before is content + left after.

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
        salt = (pad(content) > most) & ~fixed
        guess = np.minimum(pad(content), most)
        for _ in range(_ROUNDS):
            unknown = wet & ~fixed & ~salt
            held = np.where(salt, most if np.isfinite(most) else 0.0, 0.0)
            dissolved = self._solve(unknown, held, guess, offered / step, 1.0 / step)
            flow = self._flow(dissolved)
            after = offered + step * flow
            full = np.where(salt, after > most, dissolved > most) & ~fixed & wet
            if (full == salt).all():
                break
            salt, guess = full, np.minimum(dissolved, most)
        else:
            raise ConvergenceError(f"ions: where salt is does not settle in {_ROUNDS} rounds")
        left = self.volume * float(after[fixed].sum())
        after[fixed] = 0.0
        return self.sum.crop(after), left

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
        """C of (shift + A) C = right on the unknown nodes, `held` on the others."""
        if not unknown.any():
            return held
        assert self._bonds is not None
        bonds: Operator = self._between(unknown.astype(float), self._bonds.right)
        operator = WithWalls(bonds, self._walls)
        stored = shift * unknown
        rows = np.maximum(operator.row_sums(), 0.0) + stored
        system = LinearSystem(operator, shift=stored, sink=rows)
        b = unknown * (right + operator.gain(held, np.zeros(self.sum.padded_shape)))
        u = unknown * guess
        size = float(np.linalg.norm(b))
        if size > 0:
            system.solve(u, system.residual(u, b), _TOLERANCE * size)
        else:
            u = np.zeros_like(u)
        return held + u
