"""What data determine: known directions are found and named, doubts predicted and met."""

import numpy as np
import pytest

from pipeline.calibration.fit import Parameter, fit
from pipeline.calibration.identifiability import (
    directions,
    identify,
    of_fit,
    predicted_deviation,
    profile,
    what_to_measure_next,
)
from tests.pipeline.calibration.synthetic import (
    PARAMETERS,
    SCATTER,
    TRUTH,
    WEEK,
    WEEKS,
    measured,
    model,
    truth,
)

NAMES = ("D_int", "D_liq", "C_sat", "l")
# d V_L / d ln p of Mg-10Gd's Table 5.1 by marches (central differences, 7 to 56 days), of which
# only the columns of D_liq and C_sat are equal to the digits that the march holds
LIMITED = np.array([
    [0.0003, 0.01538, 0.01539, 0.001],
    [0.0002, 0.02696, 0.02696, 0.008],
    [-0.0002, 0.03452, 0.03453, 0.019],
    [-0.0001, 0.03807, 0.03808, 0.031],
    [0.0003, 0.03348, 0.03348, 0.070],
])  # fmt: skip


def test_only_a_product_is_determined():
    found = directions(NAMES, LIMITED.T @ LIMITED / SCATTER**2)
    assert found[0].deviation > 100
    np.testing.assert_allclose(np.abs(found[0].components), [0, 0.707, 0.707, 0], atol=0.02)
    words = {"D_liq": "D_liq", "C_sat": "C_sat"}
    assert found[0].in_words(words) == "only D_liq C_sat is determined, not D_liq and C_sat"
    assert found[1].deviation > 1 and found[1].parts[0] == "D_int"
    sorted_out = identify(NAMES, LIMITED.T @ LIMITED / SCATTER**2)
    assert sorted_out.determined == ("D_liq", "l") and set(sorted_out.fixed) == {"D_int", "C_sat"}
    assert (sorted_out.deviations < 1).all()


def test_a_parameter_without_effect_is_named():
    blind = np.array([[1.0, 0.0], [2.0, 0.0]])
    found = identify(("D", "C_sat"), blind.T @ blind / SCATTER**2)
    assert found.determined == ("D",)
    assert found.fixed["C_sat"].in_words() == "C_sat is not determined"
    assert np.isinf(found.fixed["C_sat"].deviation)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ((1.0, -1.0), "only a / b is determined"),
        ((1.0, 0.5), "only a b^0.50 is determined"),
    ],
)
def test_other_combinations_are_named(row, words):
    sensitivity = 100 * np.array([row])
    assert words in directions("ab", sensitivity.T @ sensitivity)[0].in_words()


def test_three_parameters_that_only_act_together():
    sensitivity = np.array([[100.0, 100.0, 100.0]])
    found = directions("abc", sensitivity.T @ sensitivity)
    assert [d.deviation > 1 for d in found] == [True, True, False]
    assert identify("abc", sensitivity.T @ sensitivity).determined.__len__() == 1


def test_nothing_determined():
    found = identify("ab", np.zeros((2, 2)))
    assert found.determined == () and set(found.fixed) == {"a", "b"}


def test_bands_cover_the_truth():
    """100 synthetic data sets: the 90 % band of V_L after 12 weeks holds the truth in 80 to 97."""
    later = np.array([12 * WEEK])
    true, hits, misses = model(later, truth())[0][0], 0, []
    for seed in range(100):
        found = fit(model, measured(seed), PARAMETERS, starts=1)
        value, gradient = model(later, found.logs)
        deviation = predicted_deviation(of_fit(found).covariance, gradient[0])
        misses.append((value[0] - true) / deviation)
        hits += abs(misses[-1]) < 1.645
    assert 80 <= hits <= 97
    assert abs(np.mean(misses)) < 0.35  # no bias: a third of a standard deviation, 100 draws


def test_what_to_measure_next_says_what_one_more_measurement_gives():
    found = fit(model, measured(), PARAMETERS)
    wanted = 12 * WEEK
    now, after = what_to_measure_next(
        model, found.logs, found.fisher(), [WEEK, 12 * WEEK, 24 * WEEK], wanted, SCATTER
    )
    assert all(0 < item.deviation < now for item in after)
    assert after[1].deviation < after[0].deviation  # later tells more about later
    # and that is what the fit with the further measurement has
    more = fit(model, measured(times=np.append(WEEKS, 24 * WEEK)), PARAMETERS)
    gradient = model(np.array([wanted]), more.logs)[1][0]
    assert after[2].deviation == pytest.approx(
        predicted_deviation(of_fit(more).covariance, gradient), rel=1e-3
    )


def test_profile_is_a_parabola_near_the_optimum():
    data = measured(4)
    found = fit(model, data, PARAMETERS)
    deviation = of_fit(found).deviations[0]
    steps = np.array([-0.2, 0.0, 0.2])
    losses = profile(model, data, found.parameters, "D", np.exp(found.logs[0] + steps * deviation))
    # chi-square grows by the square of the step in standard deviations; skewness adds a tenth
    np.testing.assert_allclose(losses - found.loss, steps**2, atol=0.008)


def test_profile_of_the_only_parameter():
    only = (Parameter("D", TRUTH["D"], 1e-16, 1e-10),)

    def held(times, logs):
        values, jacobian = model(times, np.append(logs, np.log(TRUTH["l"])))
        return values, jacobian[:, :1]

    losses = profile(held, measured(), only, "D", [TRUTH["D"], 2 * TRUTH["D"]])
    assert losses[0] < 1e-12 and losses[1] > 1
