"""Metal marched alone: the same metal, and liquid that is looked at in the end."""

from dataclasses import replace

import numpy as np
import pytest

from peri.corrosion.metal.solids import Solid
from peri.corrosion.passivity import Repassivation, Rupture
from peri.corrosion.run import corrode
from peri.engine.march.marching import TimeStepping
from peri.omissions.activation import activation, corrode_activated, deviation, resting_liquid
from pipeline.scenes.grains import grain_scene
from pipeline.scenes.pits import pencil_scene

STEPPING = TimeStepping(step=40.0)


def grains(**changes):
    """A section of 60 x 40 um whose boundaries dissolve, 2 um to a node."""
    return replace(grain_scene(2e-6, size=(60e-6, 40e-6)), **changes)


def test_the_metal_is_that_of_a_march_with_liquid():
    scene, times = grains(), [1800.0, 7200.0]
    found, omission = corrode_activated(scene, times, STEPPING)
    assert omission.applied and omission.bound == 0.0 and "of each output" in omission.reason
    full = corrode(scene, times, STEPPING)
    assert found.history["metal_amount"][-1] < 0.95 * found.history["metal_amount"][0]
    np.testing.assert_allclose(found.volume_loss, full.volume_loss, rtol=1e-9)
    assert (found.metal == full.metal).all() and (full.concentration[~full.metal] > 0).any()
    assert np.abs(found.history["balance_error"]).max() < 1e-12
    assert found.history["iterations"].sum() == 0 < full.history["iterations"].sum()
    kept, omission = corrode_activated(scene, times[:1], STEPPING, refused=["transport"])
    assert not omission.applied and kept.history["iterations"].sum() > 0


def test_liquid_at_rest_is_what_a_march_tends_to():
    scene = pencil_scene(5e-6, current=100.0, depth=100e-6)
    flux, depth = scene.dissolution_flux, 50e-6
    metal = scene.metal & (scene.lattice.axis(0) > depth)
    # the front's last node is half a spacing before it, and the mouth's nodes are held up to 0
    exact = flux * depth / scene.liquid_diffusivity
    assert resting_liquid(scene, metal) == pytest.approx(exact, rel=0.06)
    assert resting_liquid(replace(scene, boundary="no_flux"), metal) == np.inf


def test_what_was_taken_for_clean_is_marched_again():
    """Liquid that is closed: the column's estimate is far below what it comes to hold."""
    closed = grains(boundary="no_flux")
    assert activation(closed, 7200.0).applied
    found, omission = corrode_activated(closed, [7200.0], STEPPING)
    assert not omission.applied and "needed: the liquid at rest has inf" in omission.reason
    full = corrode(closed, [7200.0], STEPPING)
    np.testing.assert_array_equal(found.concentration, full.concentration)


def test_laws_that_read_the_liquid_have_their_bound():
    film = Repassivation(2000.0, 3000.0, 0.1, 500.0)
    scene = grains(solids=(Solid(1e5, kinetics=film), Solid(1e5)))
    # passive up to 2000 of the 1500 mol/m^3 that bounds are stated for
    assert deviation(scene, 1500.0) == 0.0 and deviation(scene, 2250.0) == pytest.approx(4.5)
    assert activation(scene, 3600.0).applied
    low = replace(film, critical_concentration=1000.0)
    scene = grains(solids=(Solid(1e5, kinetics=low), Solid(1e5)))
    assert activation(scene, 3600.0).bound == pytest.approx(9.0)
    assert not activation(scene, 3600.0).applied
    breaks = grains(solids=(Solid(1e5, kinetics=Rupture(2000.0, 3000.0, 0.1)), Solid(1e5)))
    assert activation(breaks, 3600.0).bound == np.inf


def test_salt_layers_and_refusals():
    assert "needed: flux" in activation(pencil_scene(5e-6), 1200.0).reason
    with pytest.raises(ValueError, match="refused: .*; known: transport"):
        activation(grains(), 60.0, refused=["liquid"])
    scene = grains()
    with pytest.raises(ValueError, match="without saturation only"):
        corrode(scene, [60.0], alone=True)
    start = np.where(scene.metal, 0.0, 100.0)
    with pytest.raises(ValueError, match="in clean liquid only"):
        corrode(replace(scene, saturation="none", liquid=start), [60.0], alone=True)
    assert "needed: the liquid holds" in activation(replace(scene, liquid=start), 60.0).reason
