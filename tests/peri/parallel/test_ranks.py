"""The march on 2 MPI ranks, with `slow` on 1 and 4 as well, against the embedded solver."""

from functools import lru_cache

import numpy as np
import pytest

from peri.corrosion import corrode
from peri.corrosion.metal.bond_damage import BondDamage
from peri.engine.processes import share_out, work_per_plane
from tests.peri.parallel import rank_cases
from tests.ranks import OnRanks, needs_mpirun

slow = pytest.mark.slow
RANKS = (2, *(pytest.param(n, marks=slow) for n in (1, 4)))
CHOICES = {2: rank_cases.BY_DEFAULT, 1: (), 4: ()}
"""Marches by number of ranks, all without a name; with `slow` two ranks do all of them, too."""
RUNS = [
    *(pytest.param(name, 2, CHOICES[2], id=f"{name}-2") for name in CHOICES[2]),
    *(
        pytest.param(name, ranks, (), id=f"{name}-{ranks}-all", marks=slow)
        for name in rank_cases.MARCHES
        for ranks in (1, 2, 4)
    ),
]

pytest.importorskip("petsc4py")


@pytest.fixture(scope="module")
def on_ranks(tmp_path_factory):
    """Results of rank_cases by number of ranks, each run once."""
    return OnRanks(rank_cases.__name__, tmp_path_factory.mktemp("ranks"))


@pytest.fixture(scope="module")
def embedded():
    """Result of one of the same marches in this process, each run once."""

    @lru_cache(None)
    def result(name):
        make, times, stepping = rank_cases.MARCHES[name]
        return corrode(make(), times, stepping, **rank_cases.options(name))

    return result


@needs_mpirun
@pytest.mark.parametrize(("name", "ranks", "names"), RUNS)
def test_march_agrees_with_the_embedded_solver(name, ranks, names, on_ranks, embedded):
    arrays, expected = on_ranks(ranks, names), embedded(name)
    solid = expected.scene.solid_concentration
    # The state is not trivial: metal is lost, liquid is reached.
    assert expected.volume_loss[-1] > 0.01
    reached = expected.concentration[-1][~expected.scene.metal].max() > 1e-6 * solid
    assert reached != (name == "alone")
    if name in ("closed", "pores", "classes-inhibited", "classes-faradaic"):
        assert expected.history["saturated_nodes"].max() > 0
    if name in ("line", "pores", "alone", "classes-aged", "classes-faradaic"):
        assert expected.history["dissolved_nodes"].sum() > 0
    # the solver's tolerance: measured at most 9e-14, 4e-13, 3e-16 of it (ball, closed, line)
    difference = np.abs(arrays[f"{name}/concentration"] - expected.concentration)
    assert difference.max() <= rank_cases.SOLVER_TOLERANCE * solid
    np.testing.assert_array_equal(arrays[f"{name}/metal"], expected.metal)
    # measured at most 7.3e-14
    lost = arrays[f"{name}/volume_loss"]
    np.testing.assert_allclose(lost, expected.volume_loss, rtol=0, atol=1e-11)


@needs_mpirun
@pytest.mark.parametrize(("name", "ranks", "names"), RUNS)
def test_amounts_and_iterations_of_the_march(name, ranks, names, on_ranks, embedded):
    arrays, expected = on_ranks(ranks, names), embedded(name).history
    # round-off, as the stages close their balance: measured 2e-16
    assert np.abs(arrays[f"{name}/history/balance_error"]).max() < 1e-14
    for field in ("time", "saturated_nodes", "dissolved_nodes"):
        np.testing.assert_array_equal(arrays[f"{name}/history/{field}"], expected[field])
    for field in ("metal_amount", "liquid_amount", "released_amount"):
        scale = expected["metal_amount"][0]
        values = arrays[f"{name}/history/{field}"]
        # as the concentrations
        np.testing.assert_allclose(values, expected[field], rtol=0, atol=1e-10 * scale)
    # the same smoothing, another path through the levels: measured 84 to 90 against 85, and
    # 61 and 132 as embedded
    iterations = arrays[f"{name}/history/iterations"].sum()
    assert (iterations > 0) != (name == "alone")
    assert iterations <= 1.15 * expected["iterations"].sum()


@needs_mpirun
@pytest.mark.parametrize("ranks", RANKS)
@pytest.mark.parametrize("stiffness", rank_cases.STIFFNESSES)
def test_diffusion_system_on_ranks(stiffness, ranks, on_ranks):
    """One linear system: the same solution, and iterations that ranks and stiffness bound."""
    expected, alone = rank_cases.solve(
        *rank_cases.diffusion_system(rank_cases.ball_scene(), stiffness=stiffness)
    )
    assert np.abs(expected).max() > 0
    arrays = on_ranks(ranks, CHOICES[ranks])
    x, count = arrays[f"diffusion/{stiffness:g}"], arrays[f"diffusion/{stiffness:g}/iterations"]
    # relative residual 1e-10: measured 5.3e-11
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    # measured 11 to 14, embedded 11 and 13
    assert 5 <= count <= alone + 3


@needs_mpirun
@pytest.mark.parametrize("ranks", RANKS)
@pytest.mark.parametrize("name", rank_cases.OPERATORS)
def test_bonds_of_all_kinds_on_ranks(name, ranks, on_ranks):
    """One linear system of each kind of bond, symmetric or not, as in one process."""
    scene = rank_cases.ball_scene()
    expected, alone = rank_cases.solve(*rank_cases.bond_system(name, scene))
    assert np.abs(expected).max() > 0
    arrays = on_ranks(ranks, CHOICES[ranks])
    x, count = arrays[f"bonds/{name}"], arrays[f"bonds/{name}/iterations"]
    # relative residual 1e-10
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    assert 3 <= count <= alone + 4


@needs_mpirun
@pytest.mark.parametrize("ranks", RANKS)
@pytest.mark.parametrize("name", rank_cases.STOPPED)
def test_checkpoint_of_ranks_resumes_there_and_in_one_process(name, ranks, on_ranks, embedded):
    arrays = on_ranks(ranks, CHOICES[ranks])
    # What rank 0 raised in a report reached the others, which report nothing.
    reports = [rank_cases.STOPPED[name]] + [0] * (ranks - 1)
    np.testing.assert_array_equal(arrays[f"stopped/{name}"], reports)
    np.testing.assert_array_equal(arrays[f"resumed/{name}"], arrays[f"{name}/concentration"])
    make, times, stepping = rank_cases.MARCHES[name]
    resumed = corrode(
        make(), times, stepping, **rank_cases.options(name), resume=True, checkpoint_every=1e9,
        checkpoint=on_ranks.file(ranks, CHOICES[ranks], f".{name}"),
    )  # fmt: skip
    expected = embedded(name)
    assert len(resumed.history["time"]) == len(expected.history["time"])
    solid = expected.scene.solid_concentration
    difference = np.abs(resumed.concentration - expected.concentration).max()
    assert difference <= rank_cases.SOLVER_TOLERANCE * solid  # as the marches


@needs_mpirun
@pytest.mark.parametrize("ranks", RANKS)
def test_blocks_narrower_than_the_reach_are_refused(ranks, on_ranks):
    if ranks == 1:
        assert "refusal" not in on_ranks(ranks, CHOICES[ranks])
        return
    assert str(on_ranks(ranks, CHOICES[ranks])["refusal"]) == (
        f"ranks: {ranks} for a lattice of 3 nodes; every rank's block must be at least as "
        "wide as the stencil reaches, 2 nodes, so use fewer"
    )


@needs_mpirun
@pytest.mark.parametrize("ranks", RANKS)
def test_broken_bonds_are_those_of_one_process(ranks, on_ranks, embedded):
    """One hashed number a bond: the same bonds to the last one, whoever computed the loss."""
    result, arrays = embedded("ball"), on_ranks(ranks, CHOICES[ranks])
    scene = result.scene
    damage = BondDamage(
        scene.lattice, scene.horizon, scene.metal, scene.solid_concentration,
        scene.saturation_concentration, 7,
    )  # fmt: skip
    found = []
    for concentration, metal in (
        (result.concentration[-1], result.metal[-1]),
        (arrays["ball/concentration"][-1], arrays["ball/metal"][-1]),
    ):
        share = np.where(metal, damage.corroded(concentration), 1.0)
        found.append(damage.damage_index(share))
    assert 0.05 < np.nanmean(found[0][scene.metal]) < 0.95
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize(
    ("shape", "ranks", "expected"),
    [
        ((64, 64, 64), 1, (1, 1, 1)),
        ((64, 64, 64), 2, (2, 1, 1)),
        ((64, 64, 64), 4, (2, 2, 1)),
        ((64, 64, 64), 8, (2, 2, 2)),
        ((20, 20, 400), 2, (1, 1, 2)),  # fewest nodes beside a cut
        ((30, 30), 3, (3, 1)),  # rows stay whole
        ((100,), 4, (4,)),
    ],
)
def test_blocks(shape, ranks, expected):
    edges = share_out(work_per_plane(np.ones(shape, bool)), 3, ranks)
    assert tuple(len(e) - 1 for e in edges) == expected
    for e, n in zip(edges, shape, strict=True):
        assert e[0] == 0 and e[-1] == n and np.diff(e).min() >= 3
        # cuts suit coarse levels at up to a tenth of a block
        assert np.abs(np.diff(e) - n / (len(e) - 1)).max() <= 0.2 * n / (len(e) - 1)


def test_blocks_follow_the_work():
    """A body at one end of the lattice: the cut goes through its middle."""
    domain = np.zeros((128, 8), bool)
    domain[:40] = True
    (first, cut, last), _ = share_out(work_per_plane(domain), 2, 2)
    share = domain[first:cut].sum() / domain.sum()
    assert cut % 8 == 0 and last == 128  # a multiple of a power of two
    assert 0.5 <= share <= 0.75  # empty planes count a tenth: measured 0.6


@pytest.mark.parametrize(("shape", "ranks"), [((7,), 3), ((5, 5), 7), ((5, 5, 5), 16)])
def test_too_many_blocks_are_refused(shape, ranks):
    with pytest.raises(ValueError, match=f"ranks: {ranks} for a lattice of"):
        share_out(work_per_plane(np.ones(shape, bool)), 3, ranks)
