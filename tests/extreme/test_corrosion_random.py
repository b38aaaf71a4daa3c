"""Random small scenes: what holds always, or one clear sentence of refusal."""

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from peri.corrosion.kinetics import ConstantRate, VolumeLossLaw
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping
from tests.peri.corrosion.test_run import check_invariants

SOLID = 6e4


def powers(low, high):
    return st.floats(low, high).map(lambda p: 10.0**p)


@st.composite
def scenes(draw):
    """A lattice of one to three axes with any pattern of metal, liquid and nothing."""
    longest = draw(st.sampled_from([(24,), (8, 8), (5, 5, 5)]))
    shape = tuple(draw(st.integers(1, n)) for n in longest)
    spacing = [1e-4] * len(shape)
    spacing[draw(st.integers(0, len(shape) - 1))] *= draw(st.sampled_from([1.0, 1.0, 2.5, 25.0]))
    ratio = draw(st.sampled_from([1.0, 2.0, 3.0, 3.3]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    domain = rng.random(shape) < draw(st.sampled_from([1.0, 0.8]))
    metal = domain & (rng.random(shape) < draw(st.sampled_from([0.0, 0.1, 0.5, 0.9, 1.0])))
    fraction = None
    if draw(st.booleans()):
        fraction = np.where(metal, rng.uniform(0.2, 1.0, shape), 0.0)
        fraction += np.where(metal, 0.0, rng.uniform(0.0, 0.5, shape) * (rng.random(shape) < 0.5))
    return CorrosionScene(
        Lattice((0.0,) * len(shape), tuple(spacing), shape),
        tuple(ratio * h for h in spacing),
        metal,
        domain,
        fraction,
        boundary=draw(st.sampled_from(["refreshed", "no_flux"])),
        solid_concentration=SOLID,
        saturation_concentration=SOLID * draw(powers(-5.0, -0.48)),
        liquid_diffusivity=draw(powers(-12.0, -7.0)),
        interface_diffusivity=draw(st.one_of(powers(-17.0, -12.0), st.sampled_from([0.0, 1e-9]))),
        kinetics=draw(st.one_of(st.just(ConstantRate()), powers(-2.5, 0.0).map(VolumeLossLaw))),
        kernel_exponent=draw(st.sampled_from([0.0, -0.5, 0.5])),
        calibration=draw(st.sampled_from(["discrete", "as_published"])),
        saturation=draw(st.sampled_from(["complementarity", "as_published", "none"])),
    )


@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(scenes(), powers(0.0, 8.5), st.sampled_from(["backward_euler", "sdirk2", None]),
       st.integers(1, 10))  # fmt: skip
def test_bounds_balance_and_monotony(scene, end, scheme, steps):
    """1 s to 10 years in fixed steps of both schemes or in controlled ones."""
    if scene.saturation == "as_published":
        scheme = "backward_euler"
    stepping = TimeStepping() if scheme is None else TimeStepping(scheme, step=end / steps)
    result = corrode(scene, [0.5 * end, end], stepping)
    check_invariants(scene, result)
    assert result.history["time"][-1] == end
    touching = result.history["volume_loss"][-1] > 1e-12  # round-off of a sum
    if not scene.metal.any() or scene.metal.sum() == scene.domain.sum():
        assert not touching


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    st.fixed_dictionaries(
        {
            "solid_concentration": st.floats(allow_nan=True, allow_infinity=True),
            "saturation_concentration": st.floats(allow_nan=True, allow_infinity=True),
            "liquid_diffusivity": st.floats(allow_nan=True, allow_infinity=True),
            "interface_diffusivity": st.floats(allow_nan=True, allow_infinity=True),
            "horizon": st.one_of(
                st.floats(-1e-2, 1e-2), st.sampled_from([float("nan"), float("inf"), 0.0])
            ),
        }
    )
)
def test_any_number_is_accepted_or_refused_in_one_sentence(numbers):
    metal = np.array([False, True, False])
    try:
        scene = CorrosionScene(
            Lattice((0.0,), (1e-3,), (3,)), numbers.pop("horizon"), metal, **numbers
        )
    except ValueError as error:
        message = str(error)
        assert "\n" not in message and any(name in message for name in (*numbers, "horizon"))
    else:
        assert 0 < scene.saturation_concentration < scene.solid_concentration < np.inf
        assert 0 <= scene.interface_diffusivity < np.inf > scene.liquid_diffusivity > 0
