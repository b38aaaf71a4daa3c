"""Linear systems of the tensile test: PETSc, MUMPS for small ones, GMRES with GAMG for large ones."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fem.discretisation import Discretisation

log = logging.getLogger(__name__)

SOLVERS = ("auto", "mumps", "gamg")
_MUMPS_UNKNOWNS = 60_000  # above, factorisation costs more than multigrid
_STALE_ITERATIONS = 25  # a kept preconditioner that needs more is set up anew
_MAXIMUM_ITERATIONS = 400


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

    K is the scalar CSR of the assembly. A factorisation or multigrid hierarchy is kept as long as
    GMRES converges with it in few iterations; if the chosen method fails, the other one is tried.
    """

    def __init__(self, comm: MPI.Comm, discretisation: Discretisation, kind: str = "auto") -> None:
        if kind not in SOLVERS:
            raise ValueError(f"linear solver is {kind!r}; allowed are {', '.join(SOLVERS)}")
        d = discretisation
        self.comm, self.discretisation = comm, d
        self.statistics = LinearStatistics()
        unknowns = 3 * d.mesh.total_nodes
        self.kind = ("mumps" if unknowns <= _MUMPS_UNKNOWNS else "gamg") if kind == "auto" else kind
        self.statistics.kind = self.kind
        self._indptr, self._indices = self._scalar_pattern()
        rows = 3 * d.owned_nodes
        sizes = ((rows, unknowns), (rows, unknowns))
        self.matrix = PETSc.Mat().create(comm)
        self.matrix.setSizes(sizes)
        self.matrix.setBlockSize(3)
        self.matrix.setType(PETSc.Mat.Type.AIJ)
        self.matrix.setPreallocationCSR((self._indptr, self._indices))
        self.matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_LOCATION_ERR, True)
        self.solution, self.right = self.matrix.createVecs()
        self._near_null = self._rigid_body_modes()
        self.matrix.setNearNullSpace(self._near_null)
        self._solvers: dict[str, PETSc.KSP] = {}
        self._fresh = False

    def _scalar_pattern(self) -> tuple[np.ndarray, np.ndarray]:
        d = self.discretisation
        counts = np.diff(d.row_start)
        widths = np.repeat(3 * counts, 3)
        indptr = np.concatenate([[0], np.cumsum(widths)])
        scalar = (3 * d.mesh.global_nodes[d.columns][:, None] + np.arange(3)).ravel()
        starts = np.repeat(3 * d.row_start[:-1], 3)
        offsets = np.arange(indptr[-1]) - np.repeat(indptr[:-1], widths)
        indices = scalar[np.repeat(starts, widths) + offsets]
        # PETSc sorts the columns of a row when it inserts; it does not need them sorted here
        return indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType)

    def _rigid_body_modes(self) -> PETSc.NullSpace:
        d = self.discretisation
        coordinates = PETSc.Vec().createMPI((3 * d.owned_nodes, None), bsize=3, comm=self.comm)
        coordinates.array[:] = d.coordinates[: d.owned_nodes].ravel()
        return PETSc.NullSpace().createRigidBody(coordinates)

    def set_values(self, values: np.ndarray) -> None:
        """New stiffness values (scalar CSR order of the assembly)."""
        self.matrix.setValuesCSR(self._indptr, self._indices, values)
        self.matrix.assemble()
        self._fresh = False

    def _solver(self, kind: str) -> PETSc.KSP:
        if kind in self._solvers:
            return self._solvers[kind]
        ksp = PETSc.KSP().create(self.comm)
        prefix = f"fem_{kind}_{id(self)}_"
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(self.matrix)
        ksp.setType(PETSc.KSP.Type.FGMRES if kind == "gamg" else PETSc.KSP.Type.GMRES)
        ksp.setGMRESRestart(60)
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setPCSide(PETSc.PC.Side.RIGHT)
        pc = ksp.getPC()
        options = PETSc.Options()
        names = []
        if kind == "mumps":
            pc.setType(PETSc.PC.Type.LU)
            pc.setFactorSolverType("mumps")
            names = [("mat_mumps_icntl_14", 60), ("mat_mumps_icntl_4", 0)]
        else:
            pc.setType(PETSc.PC.Type.GAMG)
            names = [
                ("pc_gamg_threshold", 0.01),
                ("pc_gamg_coarse_eq_limit", 1000),
                ("mg_levels_ksp_type", "chebyshev"),
                ("mg_levels_pc_type", "sor"),
                ("mg_levels_ksp_max_it", 2),
                ("mg_coarse_sub_pc_type", "lu"),
            ]
        for name, value in names:
            options[prefix + name] = value
        ksp.setFromOptions()
        for name, _ in names:
            options.delValue(prefix + name)
        self._solvers[kind] = ksp
        return ksp

    def _setup(self, ksp: PETSc.KSP) -> bool:
        start = time.perf_counter()
        ksp.getPC().setReusePreconditioner(False)
        ksp.setOperators(self.matrix)
        try:
            ksp.setUp()
            good = True
        except PETSc.Error:
            good = False
        self.statistics.setups += 1
        self.statistics.setup_seconds += time.perf_counter() - start
        return good

    def _iterate(self, ksp: PETSc.KSP, tolerance: float, limit: int) -> bool:
        start = time.perf_counter()
        ksp.getPC().setReusePreconditioner(True)
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
        """Solve for the right side (owned, 3); None when every method failed.

        Returns the solution on all local nodes (n, 3), ghosts included.
        """
        self.statistics.solves += 1
        self.right.array[:] = right.ravel()
        first = self.kind
        second = "gamg" if first == "mumps" else "mumps"
        known = first in self._solvers
        ksp = self._solver(first)
        done = known and self._iterate(ksp, tolerance, _STALE_ITERATIONS)
        if not done:
            done = self._setup(ksp) and self._iterate(ksp, tolerance, _MAXIMUM_ITERATIONS)
        if not done:
            self.statistics.fallbacks += 1
            log.info("linear solver %s failed, trying %s", first, second)
            ksp = self._solver(second)
            done = self._setup(ksp) and self._iterate(ksp, tolerance, _MAXIMUM_ITERATIONS)
        return self._with_ghosts() if done else None

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
        for ksp in self._solvers.values():
            ksp.destroy()
        self._near_null.destroy()
        self.matrix.destroy()
        self.solution.destroy()
        self.right.destroy()
