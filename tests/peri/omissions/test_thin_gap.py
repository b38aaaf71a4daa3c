"""A crevice as a film: known answers, balance, order, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from peri.corrosion.acidity import AcidityLaw
from peri.engine.constants import FARADAY
from peri.engine.march.marching import TimeStepping, march
from peri.engine.solvers import ConvergenceError
from peri.omissions.thin_gap import ThinGap, ThinGapProblem, potential_along

HOUR = 3600.0
MOST, SOLID, DIFFUSIVITY, LENGTH = 5600.0, 1.4e5, 7.2e-10, 12.7e-3


def crevice(seed=3e-3, nodes=254, current=1.0, diffusivity=1.0, **more) -> ThinGap:
    place = (np.arange(nodes) + 0.5) * LENGTH / nodes
    given = dict(
        length=LENGTH,
        gap=25e-6 - 20e-6 * place / LENGTH,
        concentration=np.where(place > LENGTH - seed, 0.99 * MOST, 0.0),
        law=AcidityLaw(MOST, factor=current),
        charge_number=2.5,
        diffusivity=DIFFUSIVITY * diffusivity,
        solid_concentration=SOLID,
        saturation_concentration=MOST,
    )
    return ThinGap(**{**given, **more})


def corrode(scene: ThinGap, hours=(72,), stepping: TimeStepping | None = None, **more):
    problem = ThinGapProblem(scene)
    stepping = stepping or TimeStepping(rate_change=0.1)
    return march(problem, [h * HOUR for h in hours], stepping, **more)


def test_a_seed_of_three_millimetres_ignites():
    hours = (1, 4, 12, 24, 30, 48, 72)
    done = corrode(crevice(nodes=508), hours)
    history = done.history
    at = [int(np.argmin(np.abs(history["time"] - h * HOUR))) for h in hours]
    # A separate program, 1,016 nodes and 10 s steps; the site is known to a cell of 25 um.
    expected = [12.22, 12.11, 10.47, 8.64, 8.17, 7.59, 7.29]
    np.testing.assert_allclose(1e3 * history["active_site"][at], expected, atol=0.03)
    assert 1e9 * history["lost"][-1] == pytest.approx(20.412, rel=2e-4)  # 20.4114 measured
    # 12.88 on 508 nodes there, 13.00 on 1,016.
    assert 1e6 * history["deepest"][-1] == pytest.approx(12.88, abs=0.02)
    assert np.abs(history["balance_error"]).max() < 1e-11  # 4e-14 measured
    for output in done.outputs:
        assert output["concentration"].min() >= 0 and output["concentration"].max() <= MOST
    assert (np.diff([o["gap"] for o in done.outputs], axis=0) >= 0).all()
    assert 0.4 < history["saturated_share"][-1] < 0.45


def test_a_seed_of_two_millimetres_dies_out_and_the_outcome_is_monotone():
    lost, saturated = [], []
    for seed in (1e-3, 2e-3, 2.5e-3, 3e-3, 4e-3):
        history = corrode(crevice(seed)).history
        lost.append(1e9 * history["lost"][-1])
        saturated.append(history["saturated_share"][-1])
    assert (np.diff(lost) > 0).all()
    assert lost[1] < 0.2 and saturated[1] == 0.0  # 0.189 um mm measured
    assert lost[3] > 20 and saturated[3] > 0.4


def test_with_the_constants_of_the_printed_lattice_half_a_millimetre_ignites():
    history = corrode(crevice(0.5e-3, nodes=127, current=7.57, diffusivity=0.2176)).history
    assert 1e9 * history["lost"][-1] == pytest.approx(39.438, rel=3e-3)  # 39.442 on 508 nodes
    assert 1e3 * history["active_site"][-1] == pytest.approx(1.11, abs=0.1)  # cell of 100 um


@pytest.mark.slow
def test_steps_do_not_decide():
    exact = corrode(crevice(nodes=64), stepping=TimeStepping(rate_change=0.025))
    for stepping in (
        TimeStepping(rate_change=0.2),
        TimeStepping("backward_euler", step=300.0),
        TimeStepping(rate_change=0.2, first_step=20 * HOUR),
    ):
        found = corrode(crevice(nodes=64), stepping=stepping)
        np.testing.assert_allclose(found.history["lost"][-1], exact.history["lost"][-1], rtol=1e-3)
    lost = [corrode(crevice(nodes=n)).history["lost"][-1] for n in (64, 127, 254)]
    assert abs(lost[1] / lost[2] - 1) < 1.2 * abs(lost[0] / lost[1] - 1) < 5e-3


@pytest.mark.parametrize(
    ("charge", "distance"),
    [
        pytest.param(2.0, 7.178, marks=pytest.mark.slow),
        (2.5, 8.026),
        pytest.param(3.0, 8.792, marks=pytest.mark.slow),
    ],
)
def test_steady_distance_to_saturation_is_a_quadrature(charge, distance):
    """D h C'' = -i/(zF) (1 - C/C_solid) with C' = 0 where C = C_sat, for a flat film of 25 um."""
    law, gap = AcidityLaw(MOST), 25e-6

    def steady(solid: float) -> float:
        def source(c: float) -> float:
            return float(law.current(c)) / (charge * FARADAY) * (1 - c / solid)

        def integrand(u: float) -> float:  # C = C_sat (1 - u^2), regular at the saturated end
            c = MOST * (1 - u * u)
            total = quad(source, c, MOST)[0]
            return 2 * MOST * u / np.sqrt(2 * total / (DIFFUSIVITY * gap))

        return quad(integrand, 0, 1, epsrel=1e-6, limit=30)[0]

    assert 1e3 * steady(SOLID) == pytest.approx(distance, abs=1e-3)
    # So dense a metal hardly recedes, and the film stays flat.
    nodes, dense = 254, 1e12
    scene = crevice(seed=5e-3, nodes=nodes, charge_number=charge, solid_concentration=dense)
    scene = replace(scene, gap=np.full(nodes, gap))
    done = corrode(scene, hours=(500,))
    full = done.outputs[0]["concentration"] >= MOST
    assert full.any() and not full.all()
    # The first saturated node is the one beyond the point, at most a cell of 50 um.
    found = scene.places[full].min()
    assert found == pytest.approx(steady(dense), abs=LENGTH / nodes)


def test_a_closed_gap_without_law_only_diffuses():
    scene = crevice(law=AcidityLaw(MOST, factor=1e-30), nodes=64)
    scene = replace(scene, gap=np.full(64, 10e-6))
    done = corrode(scene, hours=(10, 200))
    first, last = (o["concentration"] for o in done.outputs)
    place = scene.places
    # After long the slowest mode is left: sin(pi x / 2L), decaying at D (pi / 2L)^2.
    shape = np.sin(0.5 * np.pi * place / LENGTH)
    assert last.max() < 0.3 * first.max()
    np.testing.assert_allclose(last / last[-1], shape / shape[-1], atol=2e-3)
    assert done.history["lost"][-1] < 1e-30 * LENGTH
    assert np.abs(done.history["balance_error"]).max() < 1e-12


def test_resumed_march_is_the_same(tmp_path):
    scene, file = crevice(nodes=64), tmp_path / "state"
    whole = corrode(scene, hours=(5, 10))
    corrode(scene, hours=(5, 10), checkpoint=file, checkpoint_every=0.0)
    resumed = corrode(scene, hours=(5, 10), checkpoint=file, resume=True)
    for name, values in whole.history.items():
        np.testing.assert_array_equal(values, resumed.history[name])
    with pytest.raises(ValueError, match="another"):
        corrode(replace(scene, charge_number=2.0), hours=(5, 10), checkpoint=file, resume=True)


def test_bound():
    # h^2/D = 0.87 s, i h/(zF D C_sat) = 8.3e-5
    assert crevice().bound(1e9) == pytest.approx(8.3e-5, rel=0.02)
    assert crevice().bound(100.0) == pytest.approx(0.87e-2, rel=0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"charge_number": 0.0}, "charge_number: 0.0; it must be"),
        ({"length": np.nan}, "length: nan"),
        ({"solid_concentration": MOST}, "solid_concentration: 5600.0 .* above the saturation"),
        ({"gap": np.zeros(254)}, "gap: 0.0 m; every entry"),
        ({"gap": np.ones(3)}, r"gap: shape \(3,\), concentration \(254,\)"),
        ({"concentration": np.full(254, 2 * MOST)}, "concentration: 11200.0 to 11200.0"),
    ],
)
def test_refusals(change, message):
    with pytest.raises(ValueError, match=message):
        replace(crevice(), **change)


def test_a_step_beyond_the_branch_limit_is_refused_and_shortened():
    """Within 142 s at 5 um the amount multiplies (tau < h / (C_solid d(i/zFC_solid)/dC))."""
    scene = crevice(nodes=127)
    problem = ThinGapProblem(scene)
    state = problem.initial()
    old = {name: state.fields[name] for name in problem.evolved}
    problem.stage(old, 20.0, state)
    with pytest.raises(ConvergenceError, match="several solutions"):
        problem.stage(old, 2e4, state)
    asked = corrode(scene, (6,), TimeStepping(step=6 * HOUR))
    fine = corrode(scene, (6,))
    assert asked.history["time"].size > 10
    assert asked.history["lost"][-1] == pytest.approx(fine.history["lost"][-1], rel=0.05)


def test_the_bound_holds_across_the_gap():
    """Unevenness across a gap of one active wall, i h / (2 z F D) by the parabola of a steady flux.

    The bound has twice that, relative to C_sat.
    """
    scene = crevice(nodes=127)
    gap, most = float(scene.gap.max()), scene.saturation_concentration
    y = np.linspace(0.0, gap, 401)
    flux = float(scene.law.current(np.array([most]))[0]) / (scene.charge_number * FARADAY)
    # D C'' = flux / h (what is carried away along the gap), C' = 0 opposite, -D C' = flux here
    c = np.zeros_like(y)
    slope = flux / (scene.diffusivity * gap) * y
    c[1:] = np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(y))
    uneven = float(np.ptp(c)) / most
    assert 0 < uneven <= scene.bound(1e9)
    assert uneven == pytest.approx(0.5 * scene.bound(1e9), rel=1e-3)


def test_potential_along_the_gap():
    """Constant i and kappa: i L^2 / (2 kappa h); a kappa that varies: by quadrature."""
    nodes = 200
    scene = crevice(nodes=nodes, gap=np.full(nodes, 20e-6))
    speed = np.full(nodes, 0.7 / (2.5 * FARADAY * SOLID))
    fields = {"gap": scene.gap, "speed": speed}
    phi = potential_along(scene, fields, np.full(nodes, 3.0))
    x = scene.places
    exact = 0.7 / (3.0 * 20e-6) * (LENGTH * x - 0.5 * x**2)
    np.testing.assert_allclose(phi, exact, rtol=1e-3 / nodes)  # round-off inside
    kappa = 1.0 + 4.0 * (x / LENGTH) ** 2
    phi = potential_along(scene, fields, kappa)
    drop = quad(lambda s: 0.7 * (LENGTH - s) / (20e-6 * (1 + 4 * (s / LENGTH) ** 2)), 0, x[-1])[0]
    assert phi[-1] == pytest.approx(drop, rel=1e-4)
    with pytest.raises(ValueError, match="conductivity: 0.0 S/m"):
        potential_along(scene, fields, np.zeros(nodes))
