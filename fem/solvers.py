"""Linear systems of the tensile test: GMRES with multigrid or a factorisation before it.

Ten-node elements take the four-node ones on the same cells as the coarse level ("pmg"; the
smoother is one Gauss-Seidel sweep before and after, `two_levels.py`), small systems of four-node
elements MUMPS, large ones GAMG. The stiffness is nonsymmetric, but little so: MUMPS factorises its
symmetric part (half the work of LU) and two or three GMRES iterations do the rest; where corroded
cells make it more nonsymmetric than that, LU takes over. A factorisation or a multigrid hierarchy
is kept until the iterations that its age has cost add up to those a new one is worth.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fem.discretisation import Discretisation
from fem.multigrid import vertex_interpolation
from fem.two_levels import TwoLevelCycle

log = logging.getLogger(__name__)

SOLVERS = ("auto", "mumps", "gamg", "pmg")
_MUMPS_UNKNOWNS = 60_000  # of four-node elements; above, factorisation costs more than multigrid
_COARSE_UNKNOWNS = 60_000  # of pmg's vertices; above, they are solved by a cycle of GAMG
# in order of cost; a method that fails is not tried again in the same test, but for `_ASTRAY`
_METHODS = {
    "mumps": ("ldlt", "lu", "gamg"),
    "gamg": ("gamg", "lu"),
    "pmg": ("pmg", "ldlt", "lu", "gamg"),
}
# failures of pmg, where it has solved before, that are Newton's: metal that it draws out a thousand
# times makes a matrix not worth a factorisation (1 s against 0.2 s, for the rest of the test)
_ASTRAY = 2
_STALE_ITERATIONS = 60  # a kept preconditioner that needs more is set up anew
# iterations; `perilife bench tensile` prints it for pmg, `tensile-published` for GAMG, which is
# worth fewer there (25, two ranks) than on a tenth of the unknowns
_SETUP_WORTH = {"ldlt": 45, "lu": 45, "gamg": 55, "pmg": 6}
# of the tolerance asked for: GAMG leaves its error where the residual hardly shows it, in the soft
# cells, and Newton then takes more iterations
_SHARPER = {"gamg": 0.3}
_SHARPEST = 1e-10
_MAXIMUM_ITERATIONS = {"ldlt": 40, "lu": 40, "gamg": 300}
# pmg gives up, between 60 and 300 iterations, where a factorisation costs about as much; with few
# unknowns it is cheap to be generous
_UNKNOWNS_PER_ITERATION = 750


@dataclass
class LinearStatistics:
    """What the solver did, for the report of costs."""

    setups: int = 0
    solves: int = 0
    iterations: int = 0
    fallbacks: int = 0
    setup_seconds: float = 0.0
    solve_seconds: float = 0.0
    kind: str = field(default="")


class LinearSolver:
    """Solves K x = b for the owned rows of a Discretisation; the preconditioner is reused.

    K is the scalar CSR of the assembly. If the chosen method fails, the next one is tried.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        discretisation: Discretisation,
        fixed: np.ndarray,
        kind: str = "auto",
    ) -> None:
        """fixed (n, 3) bool: unknowns with prescribed values; see `fixed_changed`."""
        if kind not in SOLVERS:
            raise ValueError(f"linear solver is {kind!r}; allowed are {', '.join(SOLVERS)}")
        d = discretisation
        self.comm, self.discretisation, self.fixed = comm, d, fixed
        self.statistics = LinearStatistics()
        unknowns = 3 * d.mesh.total_nodes
        if kind == "auto":
            small = "mumps" if unknowns <= _MUMPS_UNKNOWNS else "gamg"
            kind = small if d.element.order == 1 else "pmg"
        self.statistics.kind = kind
        self._order = list(_METHODS[kind])
        self._indptr, self._indices = self._scalar_pattern()
        rows = 3 * d.owned_nodes
        sizes = ((rows, unknowns), (rows, unknowns))
        # on one rank PETSc reads the values where they are: inserting them takes half as long as
        # the assembly does
        self.values = np.zeros(self._indptr[-1])
        pattern = (self._indptr, self._indices)
        if comm.size == 1:
            self.matrix = PETSc.Mat().createAIJWithArrays(
                sizes, (*pattern, self.values), bsize=3, comm=comm
            )
        else:
            self.matrix = PETSc.Mat().createAIJ(sizes, bsize=3, csr=pattern, comm=comm)
            self.matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_LOCATION_ERR, True)
        self.solution, self.right = self.matrix.createVecs()
        modes = self._rigid_body_modes(d.coordinates[: d.owned_nodes])
        self.matrix.setNearNullSpace(modes)
        modes.destroy()
        self.symmetric: PETSc.Mat | None = None  # symmetric part, for MUMPS
        self._solvers: dict[str, PETSc.KSP] = {}
        self._interpolation: PETSc.Mat | None = None  # of pmg, with its coarse matrix
        self._coarse: PETSc.Mat | None = None
        self._cycle: TwoLevelCycle | None = None  # of pmg on one rank
        self._new_values = False  # that the cycle has not seen
        self._pmg_solved = False  # a system, since it is in use
        self._rate = 0.0  # iterations per decade with a fresh preconditioner
        self._excess = 0.0  # iterations that its age has cost

    def _scalar_pattern(self) -> tuple[np.ndarray, np.ndarray]:
        d = self.discretisation
        counts = np.diff(d.row_start)
        widths = np.repeat(3 * counts, 3)
        indptr = np.concatenate([[0], np.cumsum(widths)])
        scalar = (3 * d.mesh.global_nodes[d.columns][:, None] + np.arange(3)).ravel()
        starts = np.repeat(3 * d.row_start[:-1], 3)
        offsets = np.arange(indptr[-1]) - np.repeat(indptr[:-1], widths)
        indices = scalar[np.repeat(starts, widths) + offsets]
        # sorted on one rank, whose nodes have the same numbers locally and globally; on more,
        # PETSc sorts them when it inserts
        return indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType)

    def _rigid_body_modes(self, points: np.ndarray) -> PETSc.NullSpace:
        coordinates = PETSc.Vec().createMPI((points.size, None), bsize=3, comm=self.comm)
        coordinates.array[:] = points.ravel()
        modes = PETSc.NullSpace().createRigidBody(coordinates)
        coordinates.destroy()
        return modes

    def set_values(self, values: np.ndarray) -> None:
        """New stiffness values (scalar CSR order of the assembly).

        On one rank they need not be copied where they are assembled into `values`.
        """
        if self.comm.size == 1:
            if values is not self.values:
                self.values[:] = values
            self._new_values = True
            self.matrix.stateIncrease()
        else:
            self.matrix.setValuesCSR(self._indptr, self._indices, values)
        self.matrix.assemble()

    def fixed_changed(self) -> None:
        """Tell that `fixed` has other entries than before: the coarse space depends on it."""
        if "pmg" in self._solvers:
            self._forget("pmg")

    def _forget(self, kind: str) -> None:
        self._solvers.pop(kind).destroy()
        if kind == "pmg":
            self._interpolation.destroy()
            self._coarse.destroy()
            if self._cycle is not None:
                self._cycle.destroy()
                self._cycle = None

    def _solver(self, kind: str) -> PETSc.KSP:
        if kind in self._solvers:
            return self._solvers[kind]
        ksp = PETSc.KSP().create(self.comm)
        ksp.setOperators(self.matrix)
        multigrid = kind in ("gamg", "pmg")
        ksp.setType(PETSc.KSP.Type.FGMRES if multigrid else PETSc.KSP.Type.GMRES)
        ksp.setGMRESRestart(60)
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setPCSide(PETSc.PC.Side.RIGHT)
        pc = ksp.getPC()
        if kind == "pmg":
            d = self.discretisation
            self._interpolation = vertex_interpolation(self.comm, d, self.fixed)
            self._coarse = self.matrix.PtAP(self._interpolation)
            vertices = d.mesh.input_vertices[: d.owned_nodes] >= 0
            modes = self._rigid_body_modes(d.coordinates[: d.owned_nodes][vertices])
            self._coarse.setNearNullSpace(modes)
            modes.destroy()
            self._set_up_two_levels(pc)
        elif kind == "gamg":
            _set_up_aggregation(pc)
        else:
            _set_up_factorisation(pc, symmetric=kind == "ldlt")
        self._solvers[kind] = ksp
        return ksp

    def _set_up_two_levels(self, pc: PETSc.PC) -> None:
        """The coarse matrix is Galerkin's, factorised while it is small.

        Of the smoothers tried on a screw corroded for 8 weeks one forward sweep was the cheapest: a
        backward one after it, two of both or Chebyshev's iteration save too few iterations.  On
        several ranks PETSc does the cycle.
        """
        alone = self.comm.size == 1
        if not alone:
            pc.setType(PETSc.PC.Type.MG)
            pc.setMGLevels(2)
            pc.setMGInterpolation(1, self._interpolation)
            smoother = pc.getMGSmoother(1)
            smoother.setType(PETSc.KSP.Type.RICHARDSON)
            smoother.setTolerances(max_it=1)
            smoother.setNormType(PETSc.KSP.NormType.NONE)
            smoother.getPC().setType(PETSc.PC.Type.SOR)
            _set_options(smoother.getPC(), "fem_smoother_", pc_sor_local_forward=True)
        coarse = PETSc.KSP().create(self.comm) if alone else pc.getMGCoarseSolve()
        coarse.setType(PETSc.KSP.Type.PREONLY)
        coarse.setOperators(self._coarse)
        if self._interpolation.getSize()[1] <= _COARSE_UNKNOWNS:
            _set_up_factorisation(coarse.getPC(), symmetric=False)
        else:
            _set_up_aggregation(coarse.getPC())
        if alone:
            self._cycle = TwoLevelCycle(self.discretisation, self._interpolation, coarse)
            self._new_values = True
            pc.setType(PETSc.PC.Type.PYTHON)
            pc.setPythonContext(self._cycle)

    def _symmetric_part(self) -> PETSc.Mat:
        transposed = self.matrix.transpose(PETSc.Mat())
        if self.symmetric is None:
            self.symmetric = self.matrix.duplicate()
            self.symmetric.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.matrix.copy(self.symmetric, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.symmetric.axpy(1.0, transposed, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.symmetric.scale(0.5)
        transposed.destroy()
        return self.symmetric

    def _setup(self, ksp: PETSc.KSP) -> bool:
        start = time.perf_counter()
        cholesky = ksp.getPC().getType() == PETSc.PC.Type.CHOLESKY
        if ksp is self._solvers.get("pmg"):
            self.matrix.PtAP(self._interpolation, result=self._coarse)
        ksp.getPC().setReusePreconditioner(False)
        try:
            ksp.setOperators(self.matrix, self._symmetric_part() if cholesky else self.matrix)
            ksp.setUp()
            if self._cycle is not None and ksp is self._solvers.get("pmg"):
                self._cycle.set_up()
            good = True
        except PETSc.Error:
            good = False
        self.statistics.setups += 1
        self.statistics.setup_seconds += time.perf_counter() - start
        return good

    def _iterate(self, ksp: PETSc.KSP, tolerance: float, limit: int) -> bool:
        start = time.perf_counter()
        ksp.getPC().setReusePreconditioner(True)
        if self._cycle is not None and self._new_values:
            self._cycle.refresh(self.values)
            self._new_values = False
        ksp.setTolerances(rtol=tolerance, atol=1e-300, max_it=limit)
        try:
            ksp.solve(self.right, self.solution)
            good = ksp.getConvergedReason() > 0
        except PETSc.Error:
            good = False
        self.statistics.iterations += ksp.getIterationNumber()
        self.statistics.solve_seconds += time.perf_counter() - start
        return good and bool(np.isfinite(self.solution.norm()))

    def solve(self, right: np.ndarray, tolerance: float) -> np.ndarray | None:
        """Solve for the right side (owned, 3); None when every method failed, or pmg (`_ASTRAY`).

        Returns the solution on all local nodes (n, 3), ghosts included.
        """
        self.statistics.solves += 1
        self.right.array[:] = right.ravel()
        done = False
        ksp = self._solvers.get(self._order[0])
        if ksp is not None and self._excess < _SETUP_WORTH[self._order[0]]:
            goal = self._goal(tolerance)
            done = self._iterate(ksp, goal, _STALE_ITERATIONS)
            self._excess += ksp.getIterationNumber() + self._rate * np.log10(goal)
        while not done:
            ksp, goal = self._solver(self._order[0]), self._goal(tolerance)
            limit = self._limit()
            done = self._setup(ksp) and self._iterate(ksp, goal, limit)
            self._rate = -ksp.getIterationNumber() / np.log10(goal)
            self._excess = 0.0
            if not done:
                self.statistics.fallbacks += 1
                log.info("linear solver %s failed", self._order[0])
                if len(self._order) == 1:
                    break
                if self._pmg_solved and self.statistics.fallbacks <= _ASTRAY:
                    self._forget(self._order[0])
                    break
                self._forget(self._order.pop(0))
        self._pmg_solved = self._pmg_solved or (done and self._order[0] == "pmg")
        return self._with_ghosts() if done else None

    def _goal(self, tolerance: float) -> float:
        """Tolerance that the method at hand is given."""
        sharper = _SHARPER.get(self._order[0], 1.0) * tolerance
        return min(tolerance, max(sharper, _SHARPEST))

    def _limit(self) -> int:
        """Iterations with a fresh preconditioner after which the next method is taken."""
        if self._order[0] == "pmg":
            return int(np.clip(self.matrix.getSize()[0] // _UNKNOWNS_PER_ITERATION, 60, 300))
        return _MAXIMUM_ITERATIONS[self._order[0]]

    def _with_ghosts(self) -> np.ndarray:
        d = self.discretisation
        result = np.zeros_like(d.coordinates)
        result[: d.owned_nodes] = self.solution.array.reshape(-1, 3)
        if self.comm.size > 1:
            ghosts = d.mesh.global_nodes[d.owned_nodes :]
            wanted = (3 * ghosts[:, None] + np.arange(3)).ravel().astype(PETSc.IntType)
            source = PETSc.IS().createGeneral(wanted, comm=PETSc.COMM_SELF)
            target = PETSc.Vec().createSeq(len(wanted), comm=PETSc.COMM_SELF)
            scatter = PETSc.Scatter().create(self.solution, source, target, None)
            scatter.scatter(self.solution, target)
            result[d.owned_nodes :] = target.array.reshape(-1, 3)
            for item in (scatter, source, target):
                item.destroy()
        return result

    def destroy(self) -> None:
        """Free PETSc's objects (they are collective, so not left to the garbage collector)."""
        for kind in list(self._solvers):
            self._forget(kind)
        if self.symmetric is not None:
            self.symmetric.destroy()
        self.matrix.destroy()
        self.solution.destroy()
        self.right.destroy()


def _set_options(item: PETSc.PC, prefix: str, **values: object) -> None:
    """PETSc's options that have no call in petsc4py; they stay, as some are read at the set-up."""
    options = PETSc.Options()
    for name, value in values.items():
        options[prefix + name] = value
    item.setOptionsPrefix(prefix)
    item.setFromOptions()


def _set_up_factorisation(pc: PETSc.PC, symmetric: bool) -> None:
    pc.setType(PETSc.PC.Type.CHOLESKY if symmetric else PETSc.PC.Type.LU)
    pc.setFactorSolverType("mumps")
    _set_options(pc, "fem_factor_", mat_mumps_icntl_14=60, mat_mumps_icntl_4=0)


def _set_up_aggregation(pc: PETSc.PC) -> None:
    """Smoothed aggregation with PETSc's smoother, two steps of Chebyshev's iteration over Jacobi's.

    Weak couplings are kept (threshold 0): to drop them below 0.01 made the coarse levels larger,
    and both set-up and solution dearer, on a screw corroded for 8 weeks. There more steps cost more
    in all (four cost less after 24 weeks); an interpolation without smoothing needed twice the
    iterations; Gauss-Seidel breaks down where a coarse row is zero.
    """
    pc.setType(PETSc.PC.Type.GAMG)
    _set_options(pc, "fem_gamg_", pc_gamg_threshold=0.0, pc_gamg_coarse_eq_limit=1000)
