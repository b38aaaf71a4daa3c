"""Rate classes in the march: the stage against dense algebra, balance, bounds, clean liquid."""

from dataclasses import replace

import numpy as np
import pytest

from peri.corrosion.classes.cells import Cells
from peri.corrosion.classes.problem import CellProblem
from peri.corrosion.kinetics import ConstantRate, VolumeLossLaw
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping
from peri.engine.surface.rate_classes import CellExposure, RateClasses, cell_exposure
from peri.omissions.planning import LIQUID, corrode_lean, plan_omissions
from peri.omissions.reduced import ReducedCorrosion, factor_of
from peri.omissions.well_stirred import well_stirred
from tests.peri.bodies import box
from tests.peri.corrosion.test_local_kinetics import (
    ByPotential,
    Everywhere,
    Inhibited,
    Once,
    Passivating,
)
from tests.peri.dense import pair_matrix
from tests.peri.engine.surface.test_rate_classes import share_of_box

RNG = np.random.default_rng(8)
LOW, HIGH = np.array([-0.6, -0.7, -0.5]), np.array([0.8, 0.6, 0.7])


def lattice_about(n=9, spacing=0.5):
    start = -0.5 * spacing * (n - 1) + 0.07
    return Lattice((start, start + 0.03, start - 0.1), (spacing,) * 3, (n, n, n))


def brick(classes=3, **options):
    """A cuboid of about one horizon (of 1 m) in a box of liquid."""
    lattice = lattice_about()
    fraction = share_of_box(lattice, LOW, HIGH)
    settings = {
        "boundary": "no_flux",
        "solid_concentration": 100.0,
        "saturation_concentration": 1.0,
        "liquid_diffusivity": 1.0,
        "dissolution_flux": 1e-2,
        "kinetics": VolumeLossLaw(0.5),
        "exposure": cell_exposure(lattice, box(LOW, HIGH), 1.0, fraction, classes),
        **options,
    }
    return CorrosionScene(lattice, 1.0, fraction > 0, **settings)


def random_classes(seed, **options):
    """A scene of random shares and classes: two surfaces in a cell, slivers, deep metal."""
    rng = np.random.default_rng(seed)
    lattice = lattice_about(8)
    fraction = np.zeros(lattice.shape)
    inner = (slice(2, 6),) * 3
    fraction[inner] = rng.choice([0.0, 1e-6, 0.3, 0.7, 1 - 1e-6, 1.0], size=(4, 4, 4))
    cells = np.flatnonzero(fraction)
    split = rng.dirichlet(np.ones(4), size=cells.size)
    metal = RateClasses(
        np.repeat(cells, 4), (split * fraction.ravel()[cells, None]).ravel(),
        rng.exponential(size=4 * cells.size) * 20 * (rng.random(4 * cells.size) < 0.9), fraction,
    )  # fmt: skip
    liquid = rng.exponential(size=lattice.shape) * 5
    return brick_scene(lattice, CellExposure(metal, liquid), **options)


def brick_scene(lattice, exposure, **options):
    settings = {
        "solid_concentration": 100.0,
        "saturation_concentration": 1.0,
        "liquid_diffusivity": 1.0,
        "dissolution_flux": 1e-2,
        "kinetics": ConstantRate(),
        **options,
    }
    metal = exposure.metal.fraction > 0
    return CorrosionScene(lattice, 1.0, metal, exposure=exposure, **settings)


def test_stage_against_dense_algebra():
    # Saturation far away: the stage is linear for a given rate; all bonds written out.
    scene = brick(saturation_concentration=90.0, kinetics=ConstantRate())
    cells, tau = Cells(scene, 1e-12), 50.0
    crop = cells.sum.crop
    w = pair_matrix(scene.stencil, scene.lattice.shape)
    c, nu = crop(cells.share).ravel(), crop(cells.nu).ravel()
    cell = cells.columns.cell
    n, m = c.size, cell.size
    bonds = (cells.volume * cells.mu)[:, None] * w[cell] * (c * nu)
    np.testing.assert_allclose(
        bonds.sum(axis=1), cells.volume * cells.bond_sum, rtol=1e-12, atol=1e-15
    )
    k = cells.interface_rate(0.0)[0]
    matrix = np.zeros((m + n, m + n))
    matrix[:m, m:], matrix[m:, :m] = k * bonds, k * bonds.T
    matrix[m:, m:] = scene.liquid_diffusivity * w * np.outer(c, c)
    np.fill_diagonal(matrix, 0.0)
    assert np.abs(matrix - matrix.T).max() == 0
    capacity = np.concatenate([cells.volume, c])
    full = np.diag(capacity / tau + matrix.sum(axis=1)) - matrix
    held = capacity > 0
    old = np.concatenate([np.full(m, 100.0), RNG.random(n)])
    solution = np.zeros(m + n)
    solution[held] = np.linalg.solve(full[np.ix_(held, held)], (capacity * old / tau)[held])
    liquid = cells.sum.pad(old[m:].reshape(scene.lattice.shape))
    stage = cells.stage(liquid, old[:m], tau, liquid, None, 0.0)
    np.testing.assert_allclose(stage.classes, solution[:m], rtol=1e-9)
    found = crop(stage.liquid).ravel()
    np.testing.assert_allclose(found[c > 0], solution[m:][c > 0], rtol=1e-7)
    assert 0.01 < 1 - stage.classes.min() / 100.0


def test_each_class_and_the_liquid_have_their_exposures():
    cells = Cells(brick())
    arrives = cells.pull * cells.share
    wanted = cells.share * cells.liquid_bond_sum
    wanted *= (cells.volume @ cells.bond_sum) / wanted.sum()
    assert cells.dropped() == 0
    # Eight rounds of balancing, the metal's condition last; measured 2e-3.
    assert np.abs(arrives - wanted).sum() / wanted.sum() < 0.01
    plain = cells.share * cells.near(cells.scatter(cells.volume * cells.bond_sum))
    plain *= wanted.sum() / plain.sum()
    assert np.abs(plain - wanted).sum() / wanted.sum() > 0.05  # without nu


def test_liquid_sees_nearly_what_its_middles_see():
    cells = Cells(brick())
    lattice = cells.scene.lattice
    x, y, z = (np.broadcast_to(a, lattice.shape) for a in lattice.coordinates())
    spacing = lattice.spacing[0]
    middle = cells.sum.pad(x**2 + y**2 + z**2)
    mean = middle + spacing**2 / 4
    moved = cells.at_middles(mean)
    there = tuple(r + n for r, n in zip(cells.sum.reach, (1, 4, 4), strict=True))
    assert cells.share[there] == 1 and moved[there] < mean[there]
    assert moved[there] == pytest.approx(0.3 * mean[there] + 0.7 * middle[there], rel=1e-12)
    # what a cell gives the next ones receive
    seen = cells.sum.pad(9.0 + np.maximum(2.0 - x**2 - y**2 - z**2, 0.0) ** 3)
    total = (cells.share * seen).sum()
    assert (cells.share * cells.at_middles(seen)).sum() == pytest.approx(total, rel=1e-12)


def test_clean_liquid_is_the_scalar_equation():
    scene = brick(
        boundary="refreshed", liquid_diffusivity=1e4, saturation_concentration=0.5,
    )  # fmt: skip
    times = [200.0, 2000.0, 20000.0]
    found = corrode(scene, times, TimeStepping("sdirk2", rate_change=0.02))
    metal = scene.exposure.metal
    reduced = ReducedCorrosion(3 / np.pi * metal.exposure, metal.volume, 100.0 / 99.5)
    diffusivity = scene.base_interface_diffusivity()
    assert diffusivity == pytest.approx(1e-2 / (100.0 * 3.0))
    exact = reduced.volume_loss(np.array(times), diffusivity, factor_of(scene.kinetics)).value
    assert 0.05 < exact[0] and 0.4 < exact[-1] < 0.95
    np.testing.assert_allclose(found.volume_loss, exact, rtol=1e-3)  # measured 3e-4, time
    lean = well_stirred(scene, times)
    np.testing.assert_allclose(lean.volume_loss, exact, rtol=1e-12)


@pytest.mark.parametrize("law", ["proportional", "faradaic"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_balance_and_bounds_of_random_scenes(seed, law):
    scene = random_classes(
        seed, dissolution=law, boundary=("refreshed", "no_flux", "refreshed")[seed],
        liquid_diffusivity=(1.0, 0.1, 1e-3)[seed],
    )  # fmt: skip
    problem = CellProblem(scene)
    stepping = TimeStepping("sdirk2", rate_change=0.2)
    found = corrode(scene, [10.0, 300.0, 5000.0], stepping)
    assert 1e-3 < found.volume_loss[-1] and np.all(np.diff(found.volume_loss) > 0)
    assert np.abs(found.history["balance_error"]).max() < 1e-12
    assert found.history["saturated_nodes"].max() > 0 or seed == 0  # clean but for the skin
    # From the fields themselves: what a step leaves in classes and liquid, and its bounds.
    cells, state = problem.cells, problem.initial()
    liquid, classes = state.fields["concentration"], state.fields["classes"]
    for tau in (1.0, 100.0, 1e4):
        stage = cells.stage(liquid, classes, tau, liquid, None, 0.0)
        before = cells.volume @ classes + (cells.free_share * liquid).sum()
        after = cells.volume @ stage.classes + (cells.free_share * stage.liquid).sum()
        released = tau * stage.release_rate / scene.lattice.cell_volume
        assert abs(after + released - before) < 1e-12 * before
        assert (
            stage.classes.max() > 0 and stage.liquid.min() >= 0 and stage.liquid.max() <= 1.0 + 1e-9
        )
        assert stage.classes.max() <= 100.0 * (1 + 1e-12) and stage.classes.min() >= 0


def test_planning_knows_classes():
    clean = brick(boundary="refreshed", liquid_diffusivity=1e4, saturation_concentration=0.5)
    result, omissions = corrode_lean(clean, [20.0])
    liquid = next(o for o in omissions if o.name == LIQUID)
    assert liquid.applied and 0 < liquid.bound < 1e-3
    marched = corrode(clean, [20.0], TimeStepping("sdirk2", rate_change=0.02))
    assert result.volume_loss[0] == pytest.approx(marched.volume_loss[0], rel=1e-3)
    longest = plan_omissions(clean, 1e7)
    assert "rate classes turn liquid" in next(o for o in longest if o.name == LIQUID).reason
    closed = plan_omissions(brick(), 20.0)
    assert not any(o.applied for o in closed if o.name == LIQUID)


def test_classes_dissolve_into_their_cells():
    scene = brick(
        boundary="refreshed", saturation_concentration=30.0, kinetics=ConstantRate(),
        dissolution_flux=0.05,
    )  # fmt: skip
    found = corrode(scene, [100.0, 600.0, 4000.0], TimeStepping("sdirk2", rate_change=0.1))
    assert found.history["dissolved_nodes"].sum() > 50
    assert np.abs(found.history["balance_error"]).max() < 1e-12
    assert found.volume_loss[-1] > 0.5 and not found.metal[-1].all()
    assert found.metal[-1].sum() < found.metal[0].sum()


def test_checkpoint_and_resume_bitwise(tmp_path):
    scene = brick(boundary="refreshed", saturation_concentration=30.0, dissolution_flux=0.05)
    stepping = TimeStepping("sdirk2", rate_change=0.1)
    whole = corrode(scene, [100.0, 2000.0], stepping)
    file = tmp_path / "march.h5"

    class Stop(Exception):
        pass

    def stop(share, text):
        if share > 0.3:
            raise Stop

    with pytest.raises(Stop):
        corrode(
            scene, [100.0, 2000.0], stepping, checkpoint=file, checkpoint_every=0.0, progress=stop
        )
    again = corrode(scene, [100.0, 2000.0], stepping, checkpoint=file, resume=True)
    assert np.array_equal(again.volume_loss, whole.volume_loss)
    assert np.array_equal(again.concentration, whole.concentration)
    assert np.array_equal(again.history["step"], whole.history["step"])


@pytest.mark.parametrize("law", ["proportional", "faradaic"])
def test_one_number_said_class_by_class_is_that_number(law):
    scene = brick(kinetics=Once(), dissolution=law)
    once = corrode(scene, [300.0], TimeStepping())
    everywhere = corrode(replace(scene, kinetics=Everywhere()), [300.0], TimeStepping())
    assert once.volume_loss[0] > 0.05
    # the stage's 1e-9 and a first step chosen alike
    assert everywhere.volume_loss[0] == pytest.approx(once.volume_loss[0], rel=1e-7)


@pytest.mark.parametrize("law", ["proportional", "faradaic"])
def test_rates_by_the_liquid_and_by_age(law):
    free = {"boundary": "refreshed", "kinetics": ConstantRate(), "dissolution": law}
    clean = brick(liquid_diffusivity=1e4, **free)
    # Age: all metal that sees liquid has seen it from the start, so g = exp(-t/100).
    aged = replace(clean, kinetics=Passivating(100.0))
    lost = corrode(aged, [200.0], TimeStepping(rate_change=0.01)).volume_loss[0]
    as_if = 100.0 * (1 - np.exp(-2.0))
    exact = corrode(clean, [as_if], TimeStepping(rate_change=0.01)).volume_loss[0]
    assert lost > 0.01 and lost == pytest.approx(exact, rel=2e-3)
    # Liquid: a stage agrees with the rate that its own liquid gives, class by class.
    slow = brick(liquid_diffusivity=3e-3, saturation_concentration=50.0, **free)
    scene = replace(slow, kinetics=Inhibited(2.0))
    cells = Cells(scene, 1e-12)
    liquid = np.zeros(cells.sum.padded_shape)
    old = np.full(cells.cell.size, 100.0)
    stage = cells.stage(liquid, old, 50.0, liquid, None, 0.0)
    seen = cells.seen_liquid(stage.liquid)
    assert seen.max() > 0.5 and np.ptp(seen[cells.bond_sum > 0]) > 0.1
    weight = (cells.free_share + cells.held_share) * cells.nu
    mu = cells.mu / (1 + seen / 2.0) * cells.base_diffusivity * 50.0
    opened = mu * cells.gather(cells.near(weight))
    drawn = mu * cells.gather(cells.near(cells.free_share * cells.nu * stage.liquid))
    wanted = (100.0 + drawn) / (1 + opened) if law == "proportional" else 100.0 * (1 - opened)
    np.testing.assert_allclose(stage.classes, wanted, rtol=1e-6)
    found = corrode(scene, [500.0], TimeStepping())
    assert np.abs(found.history["balance_error"]).max() < 1e-12
    assert found.volume_loss[0] < corrode(slow, [500.0], TimeStepping()).volume_loss[0]


def test_faraday_without_saturation():
    free = {"dissolution": "faradaic", "saturation": "none", "kinetics": ConstantRate()}
    scene = brick(boundary="refreshed", liquid_diffusivity=1e-3, **free)
    found = corrode(scene, [200.0, 1000.0], TimeStepping())
    assert np.abs(found.history["balance_error"]).max() < 1e-12
    # No metal empties so early: the flux of all classes, whatever the liquid.
    metal = scene.exposure.metal
    flux = 3 / np.pi * float(metal.volume @ metal.exposure) / float(metal.volume.sum())
    lost = scene.base_interface_diffusivity() * flux * 200.0
    assert found.volume_loss[0] == pytest.approx(lost, rel=1e-9)
    assert found.concentration[-1][found.metal[-1] == 0].max() > scene.saturation_concentration
    problem = CellProblem(scene)
    full = problem.initial()
    full.fields["concentration"] = full.fields["concentration"] + 101.0
    with pytest.raises(ValueError, match="'none' with dissolution 'faradaic'; the liquid fills"):
        problem.accept(full, [], 1.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"saturation": "as_published"}, "saturation: 'as_published' with rate classes"),
        ({"saturation": "none"}, "saturation: 'none' with rate classes"),
    ],
)
def test_laws_without_classes_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        brick(**options)
    with pytest.raises(ValueError, match="kinetics: ByPotential needs potential; rate classes"):
        brick(kinetics=ByPotential())
    with pytest.raises(ValueError, match="forward_euler"):
        corrode(brick(), [1.0], TimeStepping("forward_euler"))
