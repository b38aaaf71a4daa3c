"""The tensile test: mesh, damage and material in, force-elongation curve and strength out.

Axial displacement is prescribed on both grips (5.4 of the dissertation: zero at one end, growing to
10 % of the length at the other), quasi-static, in adaptive increments; torsion and bending are
options (`fem.loading`). Departure from the source: implicit equilibrium instead of an explicit
code; f is foreseen before an increment, one per cell; cells at f_max are removed instead of kept.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Sequence

import numpy as np
from mpi4py import MPI

from fem import compat
from fem.assembly import Assembler
from fem.constitutive.gurson import LAGGED, LIMIT
from fem.constitutive.laws import Laws
from fem.constitutive.material import Material
from fem.damage_length import DamageLength
from fem.discretisation import build
from fem.loading import MovingGrip
from fem.march import March
from fem.newton import INVERTED_PREDICTION, Equilibrium, EquilibriumSolver
from fem.outcome import TensileResult, peak_of_curve
from fem.preparation import is_sound, prepare
from fem.quadrature import Element, find_element
from fem.quadrature_state import QuadratureState, grown_by
from fem.results import Increment, restore
from fem.settings import TensileSettings
from fem.solid import remains
from fem.solvers import LinearSolver
from fem.tearing import torn_cells

log = logging.getLogger(__name__)

_FAILURES = 4  # in a row, after which cells are taken as torn or Newton goes on for longer
_AFTER_REMOVAL = 1 / 64  # of the size: with cells gone there is a jump to settle, whatever it is
_LAGS = 4.0  # times the lag wanted: what an increment may have; also what is wanted past the peak
_WELL_PAST = 0.25  # of the drop that ends a test: from there on the peak is known
_FALLING = 3  # increments since the peak, in a row, after which the peak is passed
_CREEPING = 1 / 64  # of the largest increment: what fails with less is not tried on past the peak
_KNOWN = 1e-3  # of the reaction: what it may be off past the peak (`Equilibrium.unbalanced`)


Progress = Callable[[float, str], None]


def tensile_test(
    points: np.ndarray | None,
    cells: np.ndarray | None,
    f0: np.ndarray | None,
    material: Material | Sequence[Material],
    settings: TensileSettings | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Progress | None = None,
    observers: Sequence[Callable[[Increment], None]] = (),
    resume: str | os.PathLike | None = None,
    material_of_cell: np.ndarray | None = None,
) -> TensileResult:
    """Pull (or twist, or bend) a solid and return its force-elongation curve.

    Parameters
    ----------
    points: (n, 3) vertices [m]; cells: (nc, 4); f0: (nc, nq) damage variable in [0, f_max] at the
    points of `fem.quadrature.quadrature_points`, or (nc,) or a scalar. Read on rank 0 only.
    material: of the whole solid, or several with material_of_cell: (nc,) their numbers from 0 on,
    read on rank 0.
    observers: called after each accepted increment, and by `begin` and `finish`, where they have
    these, before the first and after the last; resume: a checkpoint (see `fem.results`).

    Raises ValueError for input outside its range. Results do not depend on the number of ranks
    beyond the solver tolerance (tests/fem/test_parallel.py).
    """
    settings = settings or TensileSettings()
    element = find_element(settings.element)
    materials = (material,) if isinstance(material, Material) else tuple(material)
    error, prepared = None, None
    if comm.rank == 0:
        try:
            prepared = prepare(
                points, cells, f0, materials, material_of_cell, settings, element, comm.size
            )
        except ValueError as problem:
            error = str(problem)
    error = comm.bcast(error)
    if error is not None:
        raise ValueError(error)
    summary = comm.bcast(prepared.summary() if comm.rank == 0 else None)
    if summary["severed"]:
        zero = np.zeros(1)
        status = (
            "fully_corroded"
            if summary["counts"]["dead_cells"] == summary["counts"]["cells"]
            else "severed"
        )
        return TensileResult(
            zero, zero.copy(), summary["load"], summary["held"].length, 0.0, 0.0, status,
            **summary["counts"],
        )  # fmt: skip
    return _Test(comm, prepared, summary, materials, settings, element).run(
        progress, observers, resume
    )


class _Test:
    """One test on one communicator."""

    def __init__(
        self, comm, prepared, summary, materials, settings: TensileSettings, element: Element
    ):
        self.started = time.perf_counter()
        self.comm, self.settings, self.summary = comm, settings, summary
        self.materials = materials
        self.prepared, self.held = prepared, summary["held"]
        threads = settings.threads or (os.cpu_count() or 1 if comm.size == 1 else 1)
        root = comm.rank == 0
        local = compat.distribute(
            comm,
            *self._compact() if root else (None, None),
            prepared.plan if root else None,
            element.order,
        )
        groups = self._scatter(local.original_cells, lambda: prepared.groups)
        self.discretisation = build(local, element, groups, threads)
        of_cell = self._scatter(
            self.discretisation.original_cells, lambda: prepared.laws.of_cell[prepared.kept]
        )
        self.laws = Laws.of(materials, of_cell)
        self.laws.parameters[:, LAGGED] = float(settings.damage != "implicit")
        self.assembler = Assembler(self.discretisation, self.laws, threads)
        damage = self._scatter(
            self.discretisation.original_cells, lambda: prepared.damage[prepared.kept]
        )
        self.state = QuadratureState(damage)
        self.assembler.averaged &= is_sound(damage)
        self.limit = self.laws.per_cell(LIMIT)
        self.load = summary["load"]
        self.fixed, moved = self._fixed_unknowns()
        self.unused = np.zeros(len(self.discretisation.coordinates), bool)  # by living cells
        self.grip = MovingGrip(comm, self.load, local.coordinates, moved, local.owned_nodes)
        self.linear = LinearSolver(comm, self.discretisation, self.fixed, settings.linear_solver)
        if comm.size == 1:
            self.assembler.values = self.linear.values
        self.solver = EquilibriumSolver(
            comm, self.assembler, self.linear, self.state, self.fixed, self.grip,
            settings.tolerance, settings.maximum_iterations,
        )  # fmt: skip
        self.setup_seconds = time.perf_counter() - self.started
        self.lost_cells = self.torn_cells = 0
        if root and settings.damage_length > 0.0:
            self.average = DamageLength(*self._compact(), settings.damage_length)

    def _compact(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices in use and kept cells numbered by them; `self.vertices` leads back."""
        cells = self.prepared.cells[self.prepared.kept]
        self.vertices, numbered = np.unique(cells, return_inverse=True)
        return self.prepared.points[self.vertices], numbered.reshape(-1, 4)

    def _scatter(self, numbers: np.ndarray, values: Callable[[], np.ndarray]) -> np.ndarray:
        """Rows `numbers` of an array over the kept cells that only rank 0 has."""
        wanted = self.comm.gather(numbers)
        parts = None
        if self.comm.rank == 0:
            everything = values()
            parts = [everything[rows] for rows in wanted]
        return self.comm.scatter(parts)

    def _fixed_unknowns(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) unknowns with prescribed values, and those of them that move with the top grip."""
        mesh = self.discretisation.mesh
        lateral = not self.settings.lateral_free
        held = np.array([lateral, lateral, True])
        moved = self.held.at_top(mesh.coordinates)[:, None] & held
        fixed = moved | (self.held.at_bottom(mesh.coordinates)[:, None] & held)
        vertices = self.comm.bcast(self.vertices if self.comm.rank == 0 else None)
        for vertex, direction in self.summary["guides"]:
            number = int(np.searchsorted(vertices, vertex))
            fixed[mesh.input_vertices == number, direction] = True
        return fixed, moved

    def run(self, progress: Progress | None, observers=(), resume=None) -> TensileResult:
        """March to the end of the test."""
        s, status = self.settings, "completed"
        march = self._start() if resume is None else restore(self, resume)
        if resume is None:
            for observer in observers:
                getattr(observer, "begin", lambda increment: None)(Increment(self, march))
        ended, parted = self._ended(march, march.rows[-1][self.load.reaction]), self._parted()
        tried_ones = 0
        while not (ended or parted) and march.strain < s.maximum_strain * (1 - 1e-12):
            if tried_ones == s.tries:
                status = f"stopped: {tried_ones} increments tried at strain {march.strain:.5f}"
                break
            tried_ones += 1
            march.size = min(march.size, s.maximum_strain - march.strain)
            outcome, tried = self._increment(march)
            if not (outcome.converged or self._known(march, outcome)):
                ended = self._ended(march, outcome.reaction + outcome.unbalanced)
                if ended:
                    break
                parted = self._retreat(march, outcome, tried)
                if march.size < _CREEPING * s.maximum_increment and self._fell(march):
                    ended = True
                    break
                if march.size < s.minimum_increment:
                    status = f"stopped: {outcome.reason} at strain {march.strain:.5f}"
                    break
                continue
            self._grow()
            lag = self._lag(march, outcome)
            excess = lag / self._wanted_lag(march, outcome)
            # with cells gone there is a jump to settle, whatever the size
            settled = self.lost_cells == march.rows[-1]["lost_cells"]
            if settled and excess > _LAGS and march.shorten(excess, s.minimum_increment):
                continue
            self._accept(march, outcome, tried, lag, excess)
            self._report(march, progress)
            # the next prediction still holds: cells at the limit carried hardly anything
            removed = self._remove((self.state.old.damage >= self.limit).all(axis=1))
            for observer in observers:
                observer(Increment(self, march))
            parted = removed and self._parted()
            ended = self._ended(march, outcome.reaction)
        ended = ended or (status.startswith("stopped") and self._fell(march))
        if ended or parted:
            status = "past_peak"
        if parted:
            march.halvings = 0
            march.rows.append(self._row(march, Equilibrium(True, 0, 0.0, 0.0, 0.0)))
        for observer in observers:
            getattr(observer, "finish", lambda: None)()
        result = self._result(march, status)
        self.linear.destroy()
        return result

    def _ended(self, march: March, reaction: float) -> bool:
        """Whether the test is over at a reaction so far below its peak."""
        s = self.settings
        return not s.full_curve and reaction < (1.0 - s.peak_drop) * march.peak

    def _fell(self, march: March) -> bool:
        """Whether the reaction has done nothing but fall since the peak, for some increments."""
        reaction = np.array([row[self.load.reaction] for row in march.rows])
        since = np.diff(reaction[reaction.argmax() :])
        return not self.settings.full_curve and since.size >= _FALLING and bool((since < 0).all())

    def _known(self, march: March, outcome: Equilibrium) -> bool:
        """Whether a reaction past the peak is known without equilibrium: only the drop is asked."""
        known = outcome.unbalanced <= _KNOWN * outcome.reaction
        past = outcome.reaction + outcome.unbalanced < march.peak
        return known and past and not self.settings.full_curve

    def _start(self) -> March:
        """The solid before it is pulled."""
        size = min(self.settings.first_increment, self.settings.maximum_strain)
        march = March(np.zeros_like(self.discretisation.coordinates), size)
        march.rows.append(self._row(march, Equilibrium(True, 0, 0.0, 0.0, 0.0)))
        return march

    def _accept(
        self, march: March, outcome: Equilibrium, tried: np.ndarray, lag: float, excess: float
    ) -> None:
        """Go on from an equilibrium: state, energies, history, size of the next increment.

        lag: see `_lag`; excess: what it is of the lag wanted.
        """
        last = march.rows[-1][self.load.reaction]
        march.work += 0.5 * (last + outcome.reaction) * march.size * self.load.extent
        march.accept(tried)
        volumes = self.discretisation.volumes * self.discretisation.owned[:, None]
        march.dissipated += self.comm.allreduce(self.state.freed_energy(volumes, self.laws))
        march.dissipated += outcome.dissipated
        self.state.commit()
        march.peak = max(march.peak, outcome.reaction)
        march.rows.append(self._row(march, outcome, lag))
        s = self.settings
        march.choose_size(outcome.iterations, excess, s.minimum_increment, s.maximum_increment)
        self.solver.maximum_iterations = s.maximum_iterations

    def _report(self, march: March, progress: Progress | None) -> None:
        row, reaction = march.rows[-1], self.load.reaction
        log.info(
            "strain %.5f %s %.5g, %d iterations", march.strain, reaction, row[reaction],
            row["iterations"],
        )  # fmt: skip
        if progress is not None and self.comm.rank == 0:
            progress(
                march.strain / self.settings.maximum_strain,
                f"strain {march.strain:.4f}, {reaction} {row[reaction]:.4g} {self.load.unit}",
            )

    def _retreat(self, march: March, outcome: Equilibrium, tried: np.ndarray) -> bool:
        """After an increment without equilibrium: halve it; after several, let torn cells go.

        tried: where Newton's iteration ended, or the last equilibrium without a prediction.
        Returns True if the solid has parted.
        """
        strain = march.strain + march.size
        log.info("strain %.5f: %s, halving the increment", strain, outcome.reason)
        jump = march.failures == 0 and self.lost_cells > march.rows[-1]["lost_cells"]
        march.halve(_AFTER_REMOVAL if jump else 0.5)
        if jump:
            self.solver.maximum_iterations = 2 * self.settings.maximum_iterations
        if march.failures < _FAILURES:
            return False
        # after as many failures again, what runs away on the way to no equilibrium is torn
        at = march.displacement if march.failures < 2 * _FAILURES else tried
        if self._remove(self._torn(at)):
            march.undo_halvings()
            self.solver.maximum_iterations = self.settings.maximum_iterations
            return self._parted()
        self.solver.maximum_iterations = 2 * self.settings.maximum_iterations
        return False

    def _grow(self) -> None:
        """Take the growth of f that the tried increment ends with, averaged as the settings say."""
        if self.settings.damage == "cell":
            self.state.average_damage(self.discretisation.element.weights)
        if self.settings.damage_length > 0.0:
            self._spread_damage()

    def _lag(self, march: March, outcome: Equilibrium) -> float:
        """Share by which the reaction is off, as another f acted than that of the end.

        The work that the plastic flow would take more or less (`lagging_work`) is the grips'.
        """
        d = self.discretisation
        if self.settings.damage == "implicit" or not outcome.reaction > 0.0:
            return 0.0
        mine = d.volumes * (d.owned & self.assembler.alive)[:, None]
        work = float(self.comm.allreduce(self.state.lagging_work(mine, self.laws)))
        return work / float(outcome.reaction * march.size * self.load.extent)

    def _wanted_lag(self, march: March, outcome: Equilibrium) -> float:
        """How much f may lag: as the settings say; on the way down from the peak more."""
        s = self.settings
        past = outcome.reaction < (1.0 - _WELL_PAST * s.peak_drop) * march.peak
        return s.lag_tolerance * (_LAGS if past and not s.full_curve else 1.0)

    def _spread_damage(self) -> None:
        """Average the growth of f over the damage length; solved on rank 0, which has the mesh."""
        d, damage = self.discretisation, self.state.old.damage
        mine = d.owned & self.assembler.alive
        growth = self.state.growth()[mine, 0]
        parts = self.comm.gather((d.original_cells[mine], growth, damage[mine, 0] > 0.0))
        averaged, error = None, None
        if self.comm.rank == 0:
            total = np.zeros(len(self.prepared.kept))
            porous = np.zeros(len(total), bool)
            for cells, values, active in parts:
                total[cells], porous[cells] = values, active
            try:
                averaged = self.average.average(total, porous)
            except RuntimeError as failure:
                error = str(failure)
        error = self.comm.bcast(error)
        if error is not None:
            raise RuntimeError(error)
        spread = self._scatter(d.original_cells, lambda: averaged)[:, None]
        self.state.new.damage[:] = np.clip(grown_by(damage, spread), 0.0, self.limit)

    def _increment(self, march: March) -> tuple[Equilibrium, np.ndarray]:
        """Predict and solve the next increment; returns the outcome and the displacement."""
        if self.settings.damage != "implicit" and march.previous_size > 0.0:
            self.state.foresee(march.size / march.previous_size, self.laws)
        change = march.size * self.load.extent
        amount = (march.strain + march.size) * self.load.extent
        if march.previous is not None:
            # what no living cell holds stays where it is
            growth = np.where(self.unused[:, None], 0.0, march.previous)
            guess = march.displacement + growth * (march.size / march.previous_size)
            outcome, tried = self.solver.solve(guess, amount)
            if outcome.converged or outcome.reason != INVERTED_PREDICTION:
                return outcome, tried
        outcome, tried = Equilibrium(False, 0, 0.0, 0.0, 0.0, "no prediction"), march.displacement
        for stiff in (False, True):
            guess = self.solver.predict(march.displacement, amount - change, change, stiff)
            if guess is None:
                break
            outcome, tried = self.solver.solve(guess, amount)
            if outcome.reason != INVERTED_PREDICTION:
                break
        return outcome, tried

    def _row(self, march: March, outcome: Equilibrium, lag: float = 0.0) -> dict[str, float]:
        """A point of the curve for the history."""
        damage, strain = self.state.old.damage, self.state.old.strain
        largest = float(damage.max()) if damage.size else 0.0
        plastic = float(strain.max()) if strain.size else 0.0
        return {
            self.load.motion: march.strain * self.load.extent,
            self.load.reaction: outcome.reaction,
            "iterations": outcome.iterations,
            "halvings": march.halvings,
            "lag": lag,
            "work": march.work,
            "stored": outcome.stored,
            "dissipated": march.dissipated,
            "largest_damage": self.comm.allreduce(largest, MPI.MAX),
            "largest_plastic_strain": self.comm.allreduce(plastic, MPI.MAX),
            "lost_cells": self.lost_cells,
            "seconds": time.perf_counter() - self.started,
        }

    def _torn(self, displacement: np.ndarray) -> np.ndarray:
        """Cells taken as torn at the last equilibrium (nl,); counts them."""
        d, alive = self.discretisation, self.assembler.alive
        torn = alive & torn_cells(d, displacement, self.state.old.damage, self.laws)
        count = int(self.comm.allreduce(int((torn & d.owned).sum())))
        self.torn_cells += count
        if count:
            log.info("%d cells are taken as torn", count)
        return torn

    def _remove(self, cells: np.ndarray) -> bool:
        """Remove cells (nl,) at the limit of f or torn, and what they held; True if any."""
        d, alive = self.discretisation, self.assembler.alive
        dead = alive & cells
        newly = int(self.comm.allreduce(int((dead & d.owned).sum())))
        if newly == 0:
            return False
        alive &= ~dead
        mine = d.original_cells[d.owned & alive]
        everyone = self.comm.gather(mine)
        kept = None
        if self.comm.rank == 0:
            cells = self.prepared.cells[self.prepared.kept]
            living = np.zeros(len(cells), bool)
            living[np.concatenate(everyone)] = True
            points = self.prepared.points
            left = remains(cells, living, self.held.at_bottom(points), self.held.at_top(points))
            kept = left.kept
        kept = self.comm.bcast(kept)
        before = int(self.comm.allreduce(int((alive & d.owned).sum())))
        alive &= kept[d.original_cells]
        after = int(self.comm.allreduce(int((alive & d.owned).sum())))
        self.lost_cells += newly + before - after
        self.fix_unused()
        log.info("%d cells removed, %d more came loose", newly, before - after)
        return True

    def fix_unused(self) -> None:
        """Fix the nodes that no living cell has; call it where cells have been removed."""
        d = self.discretisation
        self.unused[:] = True
        self.unused[d.cells[self.assembler.alive]] = False
        self.fixed[self.unused] = True
        self.linear.fixed_changed()

    def _parted(self) -> bool:
        return not bool(self.comm.allreduce(int(self.assembler.alive.any()), MPI.MAX))

    def _result(self, march: March, status: str) -> TensileResult:
        history = {name: np.array([row[name] for row in march.rows]) for name in march.rows[0]}
        motion, reaction = history[self.load.motion], history[self.load.reaction]
        statistics = self.linear.statistics
        cost = {
            "seconds": time.perf_counter() - self.started,
            "setup_seconds": self.setup_seconds,
            "assembly_seconds": self.assembler.seconds,
            "assemblies": self.assembler.count,
            "preconditioner_seconds": statistics.setup_seconds,
            "solve_seconds": statistics.solve_seconds,
            "preconditioner_setups": statistics.setups,
            "linear_solves": statistics.solves,
            "linear_iterations": statistics.iterations,
            "fallbacks": statistics.fallbacks,
            "unknowns": 3 * self.discretisation.mesh.total_nodes,
        }
        at, peak = peak_of_curve(motion, reaction)
        return TensileResult(
            motion, reaction, self.load, self.held.length, peak, at, status,
            lost_cells=self.lost_cells, torn_cells=self.torn_cells, history=history, cost=cost,
            displacement=self._gather_displacement(march.displacement), **self.summary["counts"],
        )  # fmt: skip

    def _gather_displacement(self, displacement: np.ndarray) -> np.ndarray | None:
        mesh = self.discretisation.mesh
        owned = np.arange(len(mesh.coordinates)) < mesh.owned_nodes
        here = owned & (mesh.input_vertices >= 0)
        parts = self.comm.gather((mesh.input_vertices[here], displacement[here]))
        if self.comm.rank != 0:
            return None
        result = np.full_like(self.prepared.points, np.nan)
        for vertices, values in parts:
            result[self.vertices[vertices]] = values
        return result
