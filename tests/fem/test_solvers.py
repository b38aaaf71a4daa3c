"""The linear solvers: coarse space of the ten-node element, solutions, iterations, refusals."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI
from petsc4py import PETSc

from fem.assembly import constrain, multiply
from fem.multigrid import vertex_interpolation
from fem.settings import TensileSettings
from fem.solvers import LinearSolver
from tests.fem.test_assembly import assembler_of


def system(shape=(2, 2, 3), softest=1.0, element="P2"):
    """A box held at its bottom, soft in cells at random: assembler, force, values, fixed."""
    assembler, state = assembler_of(element, 0.0, shape=shape)
    d = assembler.discretisation
    soft = np.random.default_rng(4).random(len(d.cells)) < 0.3
    state.old.damage[soft] = (1.0 - softest) / 1.5  # moduli fall by 1 - 1.5 f
    fixed = np.repeat(d.coordinates[:, 2:] < 1e-9, 3, axis=1)
    result = assembler.assemble(np.zeros_like(d.coordinates), state)
    scale = float(np.abs(result.values).max())
    constrain(d.row_start, d.columns, result.values, fixed, scale)
    right = np.random.default_rng(5).normal(size=fixed.shape) * ~fixed
    return assembler, result.values, right, fixed


def residual(assembler, values, right, solution):
    d = assembler.discretisation
    product = np.empty_like(right)
    multiply(d.row_start, d.columns, values, solution, product)
    return np.linalg.norm(product - right) / np.linalg.norm(right)


def test_a_linear_displacement_is_interpolated_exactly():
    assembler, _, _, fixed = system()
    d = assembler.discretisation
    matrix = vertex_interpolation(MPI.COMM_SELF, d, np.zeros_like(fixed))
    slope = np.arange(9.0).reshape(3, 3)
    vertices = d.mesh.input_vertices[: d.owned_nodes] >= 0
    coarse, fine = matrix.createVecs()
    coarse.array[:] = (d.coordinates[vertices] @ slope).ravel()
    matrix.mult(coarse, fine)
    assert matrix.getSize() == (3 * len(d.coordinates), 3 * vertices.sum())
    np.testing.assert_allclose(fine.array.reshape(-1, 3), d.coordinates @ slope, atol=1e-15)


def test_a_fixed_unknown_is_not_moved_and_moves_no_other():
    assembler, _, _, fixed = system()
    d = assembler.discretisation
    matrix = vertex_interpolation(MPI.COMM_SELF, d, fixed).convert("dense")
    dense = matrix.getDenseArray().copy()  # the array is the matrix's, which ends with its name
    still = fixed.ravel()
    vertices = np.flatnonzero(d.mesh.input_vertices >= 0)
    own = np.repeat(np.arange(len(vertices)), 3) * 3 + np.tile([0, 1, 2], len(vertices))
    column_still = fixed[vertices].ravel()
    # each fixed vertex its own entry, no other one in rows or columns of fixed unknowns
    assert dense[still].sum() == column_still.sum() > 0
    assert dense[:, own[column_still]].sum() == column_still.sum()


@pytest.mark.parametrize(
    ("element", "kind"),
    [("P2", "pmg"), ("P2", "mumps"), ("P2", "gamg"), ("P1", "mumps"), ("P1", "gamg")],
)
def test_every_solver_solves(element, kind):
    assembler, values, right, fixed = system(softest=1e-4, element=element)
    solver = LinearSolver(MPI.COMM_SELF, assembler.discretisation, fixed, kind)
    solver.set_values(values)
    solution = solver.solve(right, 1e-8)
    assert residual(assembler, values, right, solution) <= 1.1e-8
    assert solver.statistics.fallbacks == 0 and np.all(solution[fixed] == 0.0)


def test_iterations_of_the_two_levels_grow_neither_with_the_mesh_nor_with_the_jumps():
    """One cell in three 1, 1e2 or 1e4 times softer, up to 7,803 unknowns, to 1e-8."""
    iterations = []
    for shape in ((2, 2, 3), (4, 4, 6), (8, 8, 8)):
        for softest in (1.0, 1e-2, 1e-4):
            assembler, values, right, fixed = system(shape, softest)
            solver = LinearSolver(MPI.COMM_SELF, assembler.discretisation, fixed, "pmg")
            solver.set_values(values)
            assert solver.solve(right, 1e-8) is not None
            assert solver.statistics.fallbacks == 0
            iterations.append(solver.statistics.iterations)
    # measured 15 to 27; the solver itself gives up after 60
    assert max(iterations) <= 32


def test_the_cycle_is_a_sweep_before_and_after_the_coarse_correction():
    """Against dense matrices, where a sweep solves with the lower triangle of blocks."""
    assembler, values, right, fixed = system(softest=1e-2)
    d = assembler.discretisation
    solver = LinearSolver(MPI.COMM_SELF, d, fixed, "pmg")
    solver.set_values(values)
    solver.solve(right, 1e-8)
    x, y = solver.matrix.createVecs()
    x.array[:] = right.ravel()
    solver._cycle.apply(None, x, y)
    dense = solver.matrix.convert("dense", PETSc.Mat()).getDenseArray().copy()
    lift = solver._interpolation.convert("dense", PETSc.Mat()).getDenseArray().copy()
    block = np.arange(len(dense)) // 3
    lower = np.where(block[:, None] >= block, dense, 0.0)
    step = np.linalg.solve(lower, x.array)
    coarse = lift.T @ (x.array - dense @ step)
    step += lift @ np.linalg.solve(lift.T @ dense @ lift, coarse)
    step += np.linalg.solve(lower, x.array - dense @ step)
    # single precision: 1e-7 of the largest number, times what a sweep adds up
    assert abs(y.array - step).max() <= 1e-5 * abs(step).max()


def test_the_coarse_space_follows_the_unknowns_that_cells_leave_fixed():
    assembler, values, right, fixed = system()
    d = assembler.discretisation
    solver = LinearSolver(MPI.COMM_SELF, d, fixed, "auto")
    assert solver.statistics.kind == "pmg"
    solver.set_values(values)
    solver.solve(right, 1e-8)
    fixed[d.coordinates[:, 2] > 0.9 * d.coordinates[:, 2].max()] = True
    solver.fixed_changed()
    constrain(d.row_start, d.columns, values, fixed, float(np.abs(values).max()))
    right[fixed] = 0.0
    solver.set_values(values)
    before = solver.statistics.iterations
    solution = solver.solve(right, 1e-8)
    assert residual(assembler, values, right, solution) <= 1.1e-8
    assert np.all(solution[fixed] == 0.0)
    new = LinearSolver(MPI.COMM_SELF, d, fixed, "pmg")
    new.set_values(values)
    new.solve(right, 1e-8)
    assert solver.statistics.iterations - before == new.statistics.iterations


def test_a_large_coarse_system_is_solved_by_a_cycle_that_knows_the_rigid_motions(monkeypatch):
    assembler, values, right, fixed = system((4, 4, 6), 1e-4)
    iterations = []
    for most in (60_000, 0):
        monkeypatch.setattr("fem.solvers._COARSE_UNKNOWNS", most)
        solver = LinearSolver(MPI.COMM_SELF, assembler.discretisation, fixed, "pmg")
        solver.set_values(values)
        solution = solver.solve(right, 1e-8)
        assert residual(assembler, values, right, solution) <= 1.1e-8
        assert solver.statistics.fallbacks == 0
        iterations.append(solver.statistics.iterations)
    # measured 23 and 26; 39 without the rigid motions
    assert iterations[0] < iterations[1] <= 30


def test_four_node_elements_have_no_two_levels():
    with pytest.raises(ValueError, match="linear_solver is 'pmg'; .* P1"):
        TensileSettings(element="P1", linear_solver="pmg")
