"""Far from rest: what a node that turns liquid holds at once, and what a large current books."""

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


def test_an_hour_of_a_current_that_takes_a_third_of_the_metal_books_every_element() -> None:
    kinetics = dataclasses.replace(APPLIED, applied_potential=-1.45)
    problem = Degradation(disc(kinetics=kinetics), medium("nacl"), TransportOptions(), storage=True)
    done = march(problem, [3600.0], TimeStepping("backward_euler", step=3600.0))
    assert done.history["volume_loss"][-1] > 0.3
    assert done.history["element_error"][-1] < 1e-10
