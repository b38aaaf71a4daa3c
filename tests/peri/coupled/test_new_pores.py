"""What a node that turns liquid holds at once."""

import dataclasses

from peri.coupled.degradation import Degradation
from peri.engine.march.marching import TimeStepping, march
from peri.transport.nernst_planck import TransportOptions
from tests.peri.coupled.rank_cases import APPLIED, disc
from tests.peri.coupled.test_degradation import medium


def test_pores_are_neutral_in_the_step_that_opens_them() -> None:
    light = {"solid_concentration": 600.0, "saturation_concentration": 60.0}
    kinetics = dataclasses.replace(APPLIED, applied_potential=-1.45)
    problem = Degradation(
        disc(kinetics=kinetics, **light), medium("nacl"), TransportOptions(), storage=True
    )
    done = march(problem, [1800.0], TimeStepping("backward_euler", step=1800.0))
    assert done.history["dissolved_nodes"][-1] == 9
    # 0 to 3.5 mol/m3 of magnesium around them: the mean of its logarithms was off by 2e-3.
    assert done.outputs[-1]["net_charge"] < 1e-12
