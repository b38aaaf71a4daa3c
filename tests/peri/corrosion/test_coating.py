"""A coating on every way to a volume loss: clean liquid, the march by nodes and by classes."""

from dataclasses import replace

import numpy as np
import pytest

from peri.corrosion.coating import Coating
from peri.corrosion.run import corrode
from peri.engine.march.marching import TimeStepping
from peri.omissions.bounds import least_loss
from peri.omissions.planning import corrode_lean, plan_omissions
from peri.omissions.well_stirred import clean_march, well_stirred
from tests.peri.corrosion.scenes import WEEK, pin

TIMES = [WEEK, 2 * WEEK, 3 * WEEK, 8 * WEEK]
COATING = Coating(0.1, 2.5 * WEEK)


def clean(**options):
    return pin(2, 14, saturation_concentration=0.66, liquid_diffusivity=1e-7, **options)


def test_in_clean_liquid_time_runs_slower_under_it():
    bare = well_stirred(clean(), [0.1 * WEEK, 0.2 * WEEK, 0.75 * WEEK, 5.75 * WEEK])
    coated = well_stirred(clean(coating=COATING), TIMES)
    assert coated.volume_loss[-1] > 0.02
    np.testing.assert_allclose(coated.volume_loss, bare.volume_loss, rtol=1e-12)
    np.testing.assert_allclose(coated.concentration, bare.concentration, rtol=1e-12)


@pytest.mark.parametrize("end", [2.0, 2.5, 8.0])  # before, at and after the coating's end
def test_the_march_is_that_of_clean_liquid(end):
    times = [t for t in TIMES if t < end * WEEK] + [end * WEEK]
    scene = clean(coating=COATING)
    marched = corrode(scene, times, TimeStepping("sdirk2", rate_change=0.05))
    exact = well_stirred(scene, times)
    assert marched.history["time"][-1] == times[-1] and len(marched.volume_loss) == len(times)
    assert np.all(np.diff(marched.history["time"]) > 0)
    # steps in time: measured 5.1e-4 of the loss at most
    np.testing.assert_allclose(marched.volume_loss, exact.volume_loss, rtol=1e-3)
    assert np.abs(marched.history["balance_error"]).max() < 1e-9


def test_a_coating_that_does_nothing_and_one_that_lets_nothing_through():
    stepping = TimeStepping("sdirk2", rate_change=0.1)
    bare = corrode(clean(), TIMES, stepping).volume_loss
    alike = corrode(clean(coating=Coating(1.0, 2.5 * WEEK)), TIMES, stepping).volume_loss
    np.testing.assert_allclose(alike, bare, rtol=2e-3)  # other steps: measured 6e-4
    tight = corrode(clean(coating=Coating(0.0, 2.5 * WEEK)), TIMES, stepping)
    assert not tight.volume_loss[:2].any() and tight.volume_loss[2] > 0.01
    shifted = corrode(clean(), [0.5 * WEEK, 5.5 * WEEK], stepping).volume_loss
    np.testing.assert_allclose(tight.volume_loss[2:], shifted, rtol=3e-3)  # measured 1.2e-3


def test_where_the_liquid_counts_it_is_marched_and_the_bounds_hold():
    """Held back, the liquid fills less, so that clean liquid overstates the loss by less."""
    scene = pin(2, 14, saturation_concentration=66.0, liquid_diffusivity=3e-14, coating=COATING)
    result, omissions = corrode_lean(scene, TIMES, TimeStepping("sdirk2", rate_change=0.1))
    assert not any(o.applied for o in omissions if o.name == "liquid")
    assert result.history["saturated_nodes"].any()
    exact = well_stirred(scene, TIMES).volume_loss
    assert np.all(result.volume_loss < exact) and result.volume_loss[-1] > 0.01
    assert least_loss(scene, TIMES[-1]) <= result.volume_loss[-1]
    bare = replace(scene, coating=None)
    assert least_loss(scene, TIMES[-1]) <= least_loss(bare, TIMES[-1])
    assert np.all(result.volume_loss < corrode(bare, TIMES, None).volume_loss)


def test_the_bound_of_clean_liquid_is_that_of_bare_metal():
    bounds = [
        next(o for o in plan_omissions(scene, 8 * WEEK) if o.name == "liquid").bound
        for scene in (clean(), clean(coating=COATING))
    ]
    assert bounds[0] == bounds[1] > 0


def test_a_march_goes_on_from_either_checkpoint(tmp_path):
    scene = pin(2, 14, saturation_concentration=66.0, liquid_diffusivity=3e-14, coating=COATING)
    stepping, file = TimeStepping("sdirk2", rate_change=0.2), tmp_path / "march.npz"
    whole = corrode(scene, TIMES, stepping, checkpoint=file, checkpoint_every=0.0)
    files = [file.with_name(f"coated-{file.name}"), file]
    assert all(f.exists() for f in files)
    again = corrode(scene, TIMES, stepping, checkpoint=file, resume=True)
    np.testing.assert_array_equal(again.volume_loss, whole.volume_loss)
    file.unlink()
    again = corrode(scene, TIMES, stepping, checkpoint=file, resume=True)
    np.testing.assert_array_equal(again.concentration, whole.concentration)


@pytest.mark.parametrize(("factor", "lifetime"), [(-0.1, 1.0), (1.1, 1.0), (0.5, 0.0)])
def test_out_of_range_is_refused(factor, lifetime):
    with pytest.raises(ValueError, match="it must be"):
        Coating(factor, lifetime)


def test_steps_in_clean_liquid_are_not_repeated_under_one():
    with pytest.raises(ValueError, match="coating"):
        clean_march(clean(coating=COATING), [WEEK])
