"""Metal of several solids: grains and boundaries, two metals side by side."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from peri.corrosion.kinetics import ConstantRate, Kinetics, VolumeLossLaw
from peri.corrosion.metal.solids import Solid
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import box_lattice
from peri.engine.march.marching import TimeStepping
from peri.omissions.planning import plan_omissions
from tests.peri.corrosion.scenes import WEEK, pin
from tests.peri.corrosion.test_run import check_invariants

LAWS = ("proportional", "faradaic")


def halves(scene):
    """Phase 1 left of the middle, 2 right of it."""
    right = scene.lattice.axis(0)[:, None] > 0
    return np.where(scene.metal, 1 + (right & scene.metal), 0).astype(np.uint8)


@pytest.mark.parametrize("law", LAWS)
def test_equal_solids_are_one(law):
    scene = pin(2, 14, dissolution=law, interface_diffusivity=1e-14)
    solids = (Solid(scene.solid_concentration), Solid(scene.solid_concentration))
    two = replace(scene, solids=solids, phase=halves(scene))
    once, twice = corrode(scene, [WEEK]), corrode(two, [WEEK])
    assert once.volume_loss[0] > 0.1
    difference = np.abs(once.concentration - twice.concentration).max()
    assert difference < 1e-9 * scene.solid_concentration  # measured 2e-12
    assert not two.one_rate and not any(o.applied for o in plan_omissions(two, WEEK)[1:])


@pytest.mark.parametrize("law", LAWS)
def test_a_solid_dissolves_at_its_own_flux(law):
    """Flat faces of two metals back to back in clean liquid: losses as their rates."""
    lattice = box_lattice((-1e-3,), (1e-3,), 2e-5)
    x = lattice.axis(0)
    metal = np.abs(x) < 4e-4
    phase = np.where(metal, np.where(x < 0, 1, 2), 0).astype(np.uint8)
    scene = CorrosionScene(
        lattice, 4e-5, metal, liquid_diffusivity=1e-5, dissolution_flux=1e-7, dissolution=law,
        solid_concentration=6e4, saturation_concentration=1.0, flux_calibration="axis",
        solids=(Solid(6e4), Solid(9e4, rate=3.0)), phase=phase,
    )  # fmt: skip
    time = 2e3
    result = corrode(scene, [time], TimeStepping("sdirk2", step=time / 20))
    check_invariants(scene, result)
    lost = (scene.solid_concentrations() - result.concentration[0]) * metal * 2e-5
    left, right = lost[phase == 1].sum(), lost[phase == 2].sum()
    # measured 0.99 of flux times time (proportional: the content falls), 1.000 (faradaic)
    assert left == pytest.approx(1e-7 * time, rel=0.02)
    assert right == pytest.approx(3e-7 * time, rel=0.04)
    assert result.history["metal_amount"][0] == pytest.approx(2e-5 * (20 * 6e4 + 20 * 9e4))


def test_a_fast_boundary_is_eaten_before_its_grains():
    lattice = box_lattice((0.0, 0.0), (1e-3, 6e-4), 2e-5)
    x, y = lattice.coordinates()
    metal = np.broadcast_to(y > 2e-4, lattice.shape).copy()
    boundary = metal & (np.abs(x - 5e-4) < 4e-5)
    scene = CorrosionScene(
        lattice, 4e-5, metal, liquid_diffusivity=1e-8, dissolution_flux=1e-6,
        solid_concentration=6e4, saturation_concentration=600.0, dissolution="faradaic",
        solids=(Solid(6e4), Solid(6e4, rate=8.0)), phase=metal.astype(np.uint8) + boundary,
    )  # fmt: skip
    result = corrode(scene, [2e6])
    check_invariants(scene, result)
    left = result.metal[0]
    depth = (metal & ~left).sum(axis=1) * 2e-5
    middle = np.argmin(np.abs(lattice.axis(0) - 5e-4))
    assert depth[middle] > 4 * depth[5]
    # grains recede at their own flux: i t / (zF C_solid) = 33 um, nodes of 20 um
    assert 1e-5 < depth[5] < 6e-5


@dataclass(frozen=True)
class ByPhase(Kinetics):
    """A law that looks at the phase itself."""

    needs = frozenset({"phase"})

    def rate(self, at):
        return np.where(at.phase == 2, 5.0, 1.0)


def test_phase_in_a_law_and_laws_by_solid_agree():
    scene = pin(2, 14, kinetics=ConstantRate())
    solid = scene.solid_concentration
    table = (Solid(solid), Solid(solid, rate=5.0))
    one = replace(scene, solids=table, phase=halves(scene))
    other = replace(one, solids=(Solid(solid), Solid(solid)), kinetics=ByPhase())
    results = [corrode(s, [WEEK]) for s in (one, other)]
    assert results[0].volume_loss[0] > 0.05
    np.testing.assert_allclose(results[0].concentration, results[1].concentration, rtol=1e-9)
    slowed = replace(one, solids=(Solid(solid, kinetics=VolumeLossLaw(0.01)), table[1]))
    assert corrode(slowed, [WEEK]).volume_loss[0] < results[0].volume_loss[0]


def test_refusals():
    scene = pin(2, 14)
    solid = Solid(scene.solid_concentration)
    phase = halves(scene)
    for change, message in [
        ({"solids": (solid, solid)}, "phase: it must say which of the solids"),
        ({"solids": (solid,), "phase": phase}, "phase: from 1 to 1 on the metal"),
        ({"solids": (solid, solid), "phase": phase.astype(int)}, "phase: int64"),
        ({"solids": (Solid(1.0),)}, "solids: concentration 1.0 mol/m3 must exceed C_sat"),
    ]:
        with pytest.raises(ValueError, match=message):
            replace(scene, **change)
    with pytest.raises(ValueError, match="solids: rate -1.0"):
        Solid(1.0, rate=-1.0)
    with pytest.raises(ValueError, match="solids: concentration nan"):
        Solid(float("nan"))
