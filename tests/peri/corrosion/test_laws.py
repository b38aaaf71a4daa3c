"""Every law of the rate with every law of the bonds through the same invariants.

On ranks they are marched in tests/peri/parallel.
"""

import numpy as np
import pytest

from peri.corrosion.kinetics import Exposed
from peri.corrosion.laws import INTERFACE_LAWS, interface_law
from peri.corrosion.rate_laws import KINETICS
from peri.corrosion.run import corrode
from peri.engine.march.marching import TimeStepping
from peri.omissions.planning import corrode_lean
from tests.peri.corrosion.scenes import LAWS, WEEK, law_scene
from tests.peri.corrosion.test_run import check_invariants

PAIRS = [(name, bond) for name in LAWS for bond in INTERFACE_LAWS]


def check_law(law, bond, folder):
    """Bounds, balance, monotone loss, resumption and the bound of what planning leaves out."""
    for saturation in interface_law(bond).saturations:
        scheme = "sdirk2" if saturation != "as_published" else "backward_euler"
        made = law_scene(law, bond, saturation=saturation)
        result = corrode(made, [0.3 * WEEK, WEEK], TimeStepping(scheme, step=WEEK / 10))
        check_invariants(made, result)
        assert 1e-3 < result.volume_loss[0] < result.volume_loss[1]
    path, made = folder / "march.h5", law_scene(law, bond)
    whole = corrode(made, [WEEK])

    def stop(fraction, text):
        if fraction > 0.3:
            raise KeyboardInterrupt

    options = {"checkpoint": path, "checkpoint_every": 0.0}
    with pytest.raises(KeyboardInterrupt):
        corrode(made, [WEEK], progress=stop, **options)
    resumed = corrode(made, [WEEK], resume=True, **options)
    np.testing.assert_array_equal(resumed.concentration, whole.concentration)
    np.testing.assert_array_equal(resumed.history["iterations"], whole.history["iterations"])
    slow = law_scene(law, bond, interface_diffusivity=1e-16, liquid_diffusivity=1e-8)
    lean, omissions = corrode_lean(slow, [WEEK])
    full = corrode(slow, [WEEK])
    bound = sum(o.bound for o in omissions if o.applied) + 1e-3  # and the error in time
    assert abs(lean.volume_loss[0] / full.volume_loss[0] - 1.0) <= bound


def check_slows(law):
    """What a law says of itself is true."""
    if law.never_speeds_up:
        rates = [float(law.rate(Exposed(v))) for v in np.linspace(0.0, 1.0, 101)]
        assert np.all(np.diff(rates) <= 0) and rates[-1] >= 0


@pytest.mark.parametrize(("name", "bond"), PAIRS)
def test_a_law_keeps_the_invariants(name, bond, tmp_path):
    check_law(LAWS[name], bond, tmp_path)


def test_every_row_is_in_the_catalogue():
    assert {name: type(law) for name, law in LAWS.items()} == KINETICS
    for law in LAWS.values():
        check_slows(law)
