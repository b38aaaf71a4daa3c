"""The liquid's nodes on a lattice: bonds, linear solves, and what leaves through the boundary."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from peri.engine.influence import Stencil
from peri.engine.operators import NonlocalSum
from peri.engine.processes import ONE_PROCESS, OneProcess
from peri.engine.solvers import DiffusionSystem

Held = float | np.ndarray
"""A value of all that is held; an array has one for each side (reservoirs.py)."""


@dataclass
class LiquidState:
    """A quasi-steady liquid; fields (n,) over the unknown nodes of the LiquidSpace.

    ln_component : (E, n) ln of the free components, mol/m3
    release : (n,) g;  extents : (M, n) G_m;  migrated : (E, n) X_e;  all mol/m/s
    rates : (M, n) growth of the minerals, mol/m3/s
    psi : (n,) F phi / (R T);  held_psi : of what is held, a number or one a side
    """

    ln_component: np.ndarray
    concentration: np.ndarray
    release: np.ndarray
    extents: np.ndarray
    migrated: np.ndarray
    rates: np.ndarray
    psi: np.ndarray
    net_charge: np.ndarray
    sweeps: int = 0
    iterations: int = 0
    active: list[np.ndarray] = field(default_factory=list)
    held_psi: Held = 0.0

    def copy(self) -> LiquidState:
        """Return a state of its own, to be composed anew: its concentrations are not filled in.

        Counters start at zero.
        """
        return LiquidState(
            self.ln_component.copy(),
            np.empty(self.concentration.shape),
            self.release.copy(),
            self.extents.copy(),
            self.migrated.copy(),
            self.rates.copy(),
            self.psi.copy(),
            np.empty(self.net_charge.shape),
            active=[a.copy() for a in self.active],
            held_psi=self.held_psi,
        )


class LiquidSpace:
    """Liquid nodes, of which some are held at the medium's composition (refreshed).

    Only liquid nodes that are not refreshed are unknowns; fields over them have shape (n,).  A
    node that no chain of bonds joins to the refreshed layer has no steady state of its own.

    Parameters
    ----------
    stencil : Stencil
    liquid : bool array of the lattice's shape
    refreshed : bool array of the same shape
    capacity : relative volume of the cells (default 1)
    processes : who holds which block of the lattice; masks and fields are those of the block

    Attributes
    ----------
    n : number of unknown nodes, in this process
    volume : (n,) their relative volumes c_i
    cell_volume : m3 (m2, m in two and one dimensions)
    extent : m, the diagonal of the lattice
    bonds : (n,) sum_j w_ij c_j over all liquid nodes, 1/m2
    degree : (n,) the operator's diagonal: `bonds`, and what a copy of the space adds
    exit : (n,) the same over refreshed nodes only

    Raises
    ------
    ValueError
        For masks of the wrong shape.
    """

    def __init__(
        self,
        stencil: Stencil,
        liquid: np.ndarray,
        refreshed: np.ndarray,
        capacity: np.ndarray | None = None,
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        if liquid.shape != refreshed.shape or liquid.dtype != bool or refreshed.dtype != bool:
            raise ValueError(
                f"liquid {liquid.dtype} {liquid.shape}, refreshed {refreshed.dtype} "
                f"{refreshed.shape}; both must be bool arrays of the lattice's shape"
            )
        self.processes = processes
        self.sum = NonlocalSum(stencil, liquid.shape, liquid, processes=processes)
        self.cell_volume = float(np.prod(stencil.spacing))
        whole = processes.extent(liquid.shape)
        self.extent = float(np.linalg.norm(np.multiply(whole, stencil.spacing)))
        cells = np.ones(liquid.shape) if capacity is None else capacity
        self.all_volume = self.sum.pad(np.where(liquid, cells, 0.0))
        self._held = self.sum.pad(liquid & refreshed) > 0
        free = self.sum.pad(liquid & ~refreshed) > 0
        self.index = np.flatnonzero(free)
        self.n = self.index.size
        self._free_volume = np.where(free, self.all_volume, 0.0)
        self.volume = self._free_volume.ravel()[self.index]
        self.degree = self.bonds = self.gather(self.sum(self.all_volume))
        self.exit = self.gather(self.sum(self.all_volume * self._held))
        self._pattern: list[DiffusionSystem] = []  # of copies with another degree, too

    @cached_property
    def degree_field(self) -> np.ndarray:
        """sum_j w_ij c_j at every node, padded; made when it is asked for."""
        return self.sum(self.all_volume)

    def gather(self, field: np.ndarray) -> np.ndarray:
        """Return the unknown nodes' values of a padded field, (n,)."""
        return field.ravel()[self.index]

    def spread(self, values: np.ndarray, held: Held = 0.0) -> np.ndarray:
        """Return a padded field from values (n,), `held` at refreshed nodes, 0 elsewhere."""
        field = held * self._held if held else np.zeros(self.sum.padded_shape)
        field.ravel()[self.index] = values
        return field

    def crop(self, values: np.ndarray, held: Held = 0.0, elsewhere: float = np.nan) -> np.ndarray:
        """Return an array of the lattice's shape from values (n,)."""
        field = np.where(self._held, held, elsewhere)
        field.ravel()[self.index] = values
        return self.sum.crop(field)

    def neighbours(self, values: np.ndarray, held: Held = 0.0) -> np.ndarray:
        """Return sum_j w_ij c_j u_j of values (n,) that are `held` at refreshed nodes."""
        field = np.zeros(self.sum.padded_shape)
        field.ravel()[self.index] = self.volume * values
        around = self.gather(self.sum(field))
        return around + held * self.exit if held else around

    def outflow(self, values: np.ndarray) -> np.ndarray:
        """Return c_i (A u)_i = c_i sum_j w_ij c_j (u_i - u_j), (n,)."""
        return self.volume * (self.degree * values - self.neighbours(values))

    def total(self, values: np.ndarray) -> float:
        """Return the integral of a field (n,) over the unknown nodes."""
        return self.processes.total(float(self.volume @ values)) * self.cell_volume

    # --- over all processes -------------------------------------------------------------------

    def norm(self, values: np.ndarray) -> float:
        """Root of the sum of squares of a field (n,)."""
        return self.processes.norm(values)

    def row_norms(self, rows: np.ndarray) -> np.ndarray:
        """The same of every row of (R, n), (R,)."""
        return self.processes.row_norms(rows)

    def largest(self, values: np.ndarray) -> float:
        """The largest of (..., n) values, or 0 where none is above."""
        return self.processes.largest(float(values.max(initial=0.0)))

    def largest_of_rows(self, rows: np.ndarray) -> np.ndarray:
        """The same of every row of (R, n), (R,)."""
        return self.processes.largest(rows.max(axis=1, initial=0.0))

    def lowest(self, values: np.ndarray) -> float:
        """The lowest of (..., n) values; infinite where there are none."""
        return -self.processes.largest(-float(values.min(initial=np.inf)))

    def range(self, values: np.ndarray) -> float:
        """The highest of (n,) values less the lowest."""
        return -self.lowest(-values) - self.lowest(values)

    def any(self, flags: np.ndarray) -> bool:
        """Whether any of (..., n) flags (or numbers) is set."""
        return self.processes.any(bool(flags.any()))

    def count(self, flags: np.ndarray) -> int:
        """How many of (n,) flags are set."""
        return int(self.processes.total(int(flags.sum())))

    def mean(self, values: np.ndarray) -> float:
        """The mean of (n,) values."""
        total = self.processes.total
        return total(float(values.sum())) / total(self.n)

    # --- which nodes bonds join ---------------------------------------------------------------

    def joined_to(self, reached: np.ndarray) -> np.ndarray:
        """Return which unknown nodes chains of bonds join to those of a set, (n,) bool, and it."""
        while self.any(~reached):
            grown = reached | (self.neighbours(reached.astype(float)) > 0)
            if not self.any(grown != reached):
                break
            reached = grown
        return reached

    def cut_off(self) -> np.ndarray:
        """Return which unknown nodes no chain of bonds joins to the refreshed layer, (n,) bool."""
        return ~self.joined_to(self.exit > 0)

    # --- linear systems -----------------------------------------------------------------------

    def system(
        self, held: np.ndarray | None = None, sink: np.ndarray | None = None
    ) -> DiffusionSystem:
        """Return the linear system of A u + sink u, without the nodes in `held` (n,) bool.

        sink : (n,), per volume, 1/m2

        Systems without held nodes share what a sink leaves as it is, so that no two of them can be
        solved at the same time.
        """
        extra = 0.0 if sink is None else sink
        if held is None:
            diagonal = self.spread(self.degree + extra)
            row_sums = self.spread(self.volume * (self.exit + extra))
            if self._pattern:
                return self._pattern[0].with_diagonal(diagonal, row_sums)
            self._pattern.append(
                DiffusionSystem(self.sum, self._free_volume, diagonal, 1.0, row_sums)
            )
            return self._pattern[0]
        weight = self.spread(np.where(held, 0.0, self.volume))
        diagonal = self.spread(np.where(held, 0.0, self.degree + extra))
        gone = np.where(self.spread(held.astype(float)) > 0, self._free_volume, 0.0)
        exit_ = self.exit + extra + self.gather(self.sum(gone))
        row_sums = self.spread(np.where(held, 0.0, self.volume * exit_))
        return DiffusionSystem(self.sum, weight, diagonal, 1.0, row_sums)

    def solve(
        self,
        system: DiffusionSystem,
        right: np.ndarray,
        start: np.ndarray,
        absolute: float,
        maximum_iterations: int = 200,
    ) -> tuple[np.ndarray, int]:
        """Return u with |right - c A u| <= absolute on the system's unknowns, and iterations.

        right : (n,) per cell, mol/m3/s times relative volume
        start : (n,); values at nodes that the system holds are kept and count as given
        """
        unknown = self.spread(start)
        unknown *= system.mask
        field = self.spread(right)
        held = self.gather(system.mask) == 0
        some = self.any(held)
        if some:
            given = np.where(held, start, 0.0)
            field = self.spread(right + self.volume * self.neighbours(given))
        residual = system.residual(unknown, field)
        del field  # large, and no more needed
        iterations = system.solve(unknown, residual, absolute, maximum_iterations)
        found = self.gather(unknown)
        return (np.where(held, start, found) if some else found), iterations
