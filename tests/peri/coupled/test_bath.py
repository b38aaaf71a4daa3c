"""Baths of finite volume: what the metal releases stays there, exchanges, gases, minerals."""

import numpy as np
import pytest

from peri.corrosion.kinetics import ConstantRate
from peri.coupled.bath import Bath, Exchanges
from peri.coupled.degradation import Degradation
from peri.engine.march.marching import TimeStepping, march
from peri.engine.march.runge_kutta import RungeKutta
from peri.transport.chemistry.speciation import speciate
from peri.transport.nernst_planck import TransportOptions
from tests.peri.coupled.rank_cases import disc
from tests.peri.coupled.test_degradation import medium
from tests.peri.coupled.test_vessels import BARE, DAY, crumb

STEPS = TimeStepping("sdirk2", step=0.25 * DAY)


def problem_in(name: str, bath: Bath, minerals=(), flux: float = 2e-6, options=BARE, **more):
    scene = crumb(flux, half=0.7e-3, kinetics=ConstantRate())
    return Degradation(scene, medium(name, minerals), options, bath=bath, **more)


def by_hand(problem: Degradation, taken: float, **how) -> object:
    """The medium with as much Mg(OH)2 as the metal gave, at the medium's activity coefficients."""
    chemistry, fresh = problem.medium.chemistry, problem.medium
    totals = fresh.totals[:, 0].copy()
    added = taken / problem.bath.bath.volume
    totals += problem.surroundings.liquid.released * added
    return speciate(
        chemistry, totals, "fixed", strength=0.1, held=(fresh.ln_gamma, fresh.ln_water), **how
    )


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(BARE, id="none"),
        pytest.param(TransportOptions(), id="electroneutral", marks=pytest.mark.slow),
    ],
)
def test_a_closed_bath_is_the_medium_with_what_dissolved(options: TransportOptions) -> None:
    problem = problem_in("sbf", Bath(1e-6), options=options)
    done = march(problem, [2 * DAY], STEPS)
    taken = done.state.numbers["taken"]
    assert taken == pytest.approx(done.history["hydrogen_amount"][-1], rel=1e-6)
    exact = by_hand(problem, taken)
    assert done.history["bath_ph"][-1] == pytest.approx(float(exact.ph[0]), abs=1e-8)
    assert done.history["bath_ph"][-1] > done.history["bath_ph"][0] + 0.04
    # PHREEQC: 0.1 mol/m3 of Mg(OH)2 raise 7.5735 to 7.6197; here 0.117.
    assert done.history["element_error"].max() < 1e-10  # measured 7e-12


def test_a_bath_open_to_a_gas_keeps_its_activity() -> None:
    problem = problem_in("sbf", Bath(1e-6, open_to=("CO2",)))
    done = march(problem, [2 * DAY], STEPS)
    chemistry = problem.medium.chemistry
    found = problem._hold(done.state.fields["bath"])
    co2 = chemistry.index("CO2")
    assert found.concentration[co2] == pytest.approx(problem.medium.concentration[co2], rel=1e-10)
    exact = by_hand(problem, done.state.numbers["taken"], gas=problem.bath.gas)
    assert done.history["bath_ph"][-1] == pytest.approx(float(exact.ph[0]), abs=1e-8)
    closed = march(problem_in("sbf", Bath(1e-6)), [2 * DAY], STEPS)
    rise = [d.history["bath_ph"][-1] - d.history["bath_ph"][0] for d in (done, closed)]
    assert 0 < rise[0] < 0.1 * rise[1]


def test_what_the_medium_lacks_settles_at_round_off() -> None:
    bath = Bath(1e-6, exchange=0.7 * DAY, open_to=("CO2",))  # magnesium: 0 and 2e-15 in turn
    done = march(
        Degradation(disc(), medium("sbf"), BARE, bath=bath),
        [DAY],
        Exchanges(RungeKutta(STEPS), 0.7 * DAY),
    )
    # equal steps up to each end; without the floor of round-off one is taken again in halves
    assert done.history["time"] / DAY == pytest.approx([0, 0.7 / 3, 1.4 / 3, 0.7, 0.85, 1])
    assert done.history["element_error"].max() < 1e-11  # measured 5e-13


@pytest.mark.slow
def test_exchanges_are_hit_and_bring_fresh_medium(tmp_path) -> None:
    bath = Bath(1e-6, exchange=0.7 * DAY)
    stepping = Exchanges(RungeKutta(STEPS), bath.exchange)
    done = march(problem_in("sbf", bath), [0.5 * DAY, 2 * DAY], stepping)
    times, ph = done.history["time"], done.history["bath_ph"]
    for moment in (0.7 * DAY, 1.4 * DAY):
        n = int(np.argmin(np.abs(times - moment)))
        assert times[n] == pytest.approx(moment, rel=1e-12)
        assert ph[n + 1] < ph[n] and ph[n] == ph[max(0, n - 1) : n + 1].max()
    fresh = ph[0]
    after = ph[np.flatnonzero(times > 1.4 * DAY)[0]]
    assert fresh < after < fresh + 0.02

    class Killed(Exception):
        pass

    def kill(fraction: float, text: str) -> None:
        if fraction > 0.6:
            raise Killed

    path = tmp_path / "march.h5"
    with pytest.raises(Killed):
        march(
            problem_in("sbf", bath), [0.5 * DAY, 2 * DAY], stepping,
            checkpoint=path, checkpoint_every=0.0, progress=kill,
        )  # fmt: skip
    again = march(
        problem_in("sbf", bath), [0.5 * DAY, 2 * DAY], stepping, checkpoint=path, resume=True
    )
    assert np.array_equal(again.history["bath_ph"], ph)


@pytest.mark.slow
def test_a_small_bath_of_saline_fills_with_brucite() -> None:
    problem = problem_in("nacl", Bath(1e-8), ("brucite",))
    done = march(problem, [2 * DAY], STEPS)
    ph, bath = done.history["bath_ph"], done.state.fields["bath"]
    # PHREEQC: 10.104 (its activity coefficients make up the difference of 0.02).
    assert ph[-1] == pytest.approx(10.104, abs=0.021) and (np.diff(ph) > -1e-6).all()
    mg = problem.medium.chemistry.components.index("Mg")
    formed = done.history["brucite_amount"][-1]
    assert bath[mg] * 1e-8 + formed == pytest.approx(done.state.numbers["taken"], rel=1e-8)
    assert bath[mg] > 0.25  # 0.216 of it dissolved, the rest brucite in the bath
    assert done.history["element_error"].max() < 1e-9


@pytest.mark.slow
def test_a_liquid_that_stores_shares_its_bath() -> None:
    at_rest = march(problem_in("sbf", Bath(1e-6)), [DAY], STEPS)
    stored = march(problem_in("sbf", Bath(1e-6), storage=True), [DAY], STEPS)
    assert stored.history["bath_ph"] == pytest.approx(at_rest.history["bath_ph"], abs=2e-4)
    assert stored.history["element_error"].max() < 1e-10


@pytest.mark.parametrize(
    ("bath", "says"),
    [
        ({"volume": 0.0}, "bath: its volume is 0.0 m3; it must be finite and above 0"),
        ({"volume": 1e-6, "exchange": -1.0}, "bath: exchanged every -1.0 s; it must be above 0"),
        ({"volume": 1e-6, "open_to": ("HCO3",)}, "bath: open to HCO3, which must be a neutral"),
        ({"volume": 1e-6, "open_to": ("N2",)}, "species 'N2' is unknown"),
    ],
)
def test_baths_are_checked(bath: dict, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        problem_in("sbf", Bath(**bath))


def test_a_bath_needs_a_way_in() -> None:
    with pytest.raises(ValueError, match="boundary is 'no_flux', which nothing leaves through"):
        Degradation(crumb(1e-6, boundary="no_flux"), medium("sbf"), BARE, bath=Bath(1e-6))
