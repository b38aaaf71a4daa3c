"""A stage looks at the metal beside liquid: what it leaves out changes nothing."""

import numpy as np
import pytest

from peri.corrosion.kinetics import ConstantRate, VolumeLossLaw
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.nodes.stage import StageSolver
from peri.corrosion.passivity import Repassivation
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice

SPACING = 1e-5


def thick_plate(**options):
    """Metal 40 layers thick with a notch, below 12 layers of liquid; horizon 2 spacings."""
    lattice = Lattice((0.0, 0.0), (SPACING, SPACING), (14, 52))
    x, y = lattice.coordinates()
    metal = np.broadcast_to(y < 39.5 * SPACING, lattice.shape) & ~(
        (np.abs(x - 5 * SPACING) < 1.5 * SPACING) & (y > 36.5 * SPACING)
    )
    given = {
        "solid_concentration": 1.43e5,
        "saturation_concentration": 5.1e3,
        "liquid_diffusivity": 8.5e-10,
        "dissolution_flux": 0.3,
        "kinetics": ConstantRate(),
        **options,
    }
    return CorrosionScene(lattice, 2 * SPACING, np.ascontiguousarray(metal), **given)


def both_ways(scene, tau, liquid=0.0):
    """A stage as it is and on the whole box, and the latter's solver; `liquid` is guessed."""
    found = []
    for whole in (False, True):
        problem = BiMaterial(scene, 1e-13)
        solver = problem._solver
        if whole:
            solver._part = lambda old, solver=solver: solver.whole
        old = problem.initial_concentration
        guess = np.where(problem.free, liquid, old)
        found.append(problem.implicit_stage(old, tau, guess, None, 0.0))
    return *found, solver


@pytest.mark.parametrize("law", ["proportional", "faradaic"])
@pytest.mark.parametrize(
    "options",
    [
        {"saturation": "none"},
        {},
        {"kinetics": VolumeLossLaw(0.05)},
        {"kinetics": Repassivation(100.0, 5.1e3, passive_share=0.5, width=0.9)},
    ],
    ids=["no salt", "salt", "by loss", "film"],
)
def test_what_is_far_from_liquid_plays_no_part(law, options):
    scene, tau = thick_plate(dissolution=law, **options), 3.0
    part, whole, _ = both_ways(scene, tau)
    problem = BiMaterial(scene)
    near = problem.beside_liquid()
    assert near.box.padded_shape[2] < 0.6 * problem.box.padded_shape[2]
    assert part.volume_loss > 1e-4
    if options.get("saturation") != "none":
        assert (part.theta[problem.box_free_volume > 0] < 0.99).sum() >= 5
        # solved to 1e-13 both times: measured at most 6e-12
        np.testing.assert_allclose(part.theta, whole.theta, rtol=0, atol=1e-9)
    atol = 1e-10 * scene.solid_concentration
    np.testing.assert_allclose(part.concentration, whole.concentration, rtol=0, atol=atol)
    assert part.volume_loss == pytest.approx(whole.volume_loss, rel=1e-9)
    assert part.release_rate == pytest.approx(whole.release_rate, rel=1e-9)


def test_a_stage_that_empties_more_than_it_looked_at_looks_again():
    """Six layers go in one stage, and what they expose lies off the first box."""
    scene = thick_plate(dissolution="faradaic", saturation="none", boundary="refreshed")
    tau = 6.2 * SPACING * scene.solid_concentration / scene.dissolution_flux
    part, whole, solver = both_ways(scene, tau)
    assert solver.whole.sum.crop(whole.emptied)[2, 34]
    assert np.array_equal(part.emptied, whole.emptied)
    np.testing.assert_array_equal(part.concentration, whole.concentration)


@pytest.mark.parametrize("law", ["proportional", "faradaic"])
def test_the_level_of_closed_liquid_counts_the_metal_that_takes_part(law, monkeypatch):
    """In a step far longer than diffusion takes, storage alone tells the liquid's level."""
    scene = thick_plate(dissolution=law, boundary="no_flux", dissolution_flux=1e-9)
    levelled = []
    level = StageSolver._level
    monkeypatch.setattr(
        StageSolver, "_level", lambda self, *args: levelled.append(level(self, *args))
    )
    part, whole, solver = both_ways(scene, 1e6, liquid=5.0)
    assert len(levelled) >= 2 and 1e-5 < part.volume_loss < 1e-2
    for stage in (part, whole):
        amounts = solver.whole.amounts(stage.concentration)
        metal, _ = solver.whole.amounts(solver.whole.initial_concentration)
        # measured 2e-16
        assert sum(amounts) == pytest.approx(metal, rel=1e-14)
    # the stages' liquid is known to the rounding of its sums: measured 3e-12
    np.testing.assert_allclose(part.concentration, whole.concentration, rtol=1e-9)
