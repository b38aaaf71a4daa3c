"""Ions between reservoirs and electrodes: junctions, Ohm's law, limiting current, refusals."""

import dataclasses

import numpy as np
import pytest

from peri.engine.constants import FARADAY, GAS_CONSTANT
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import box_lattice
from peri.transport.liquid import LiquidState
from peri.transport.options import TransportOptions
from peri.transport.reservoirs import BetweenReservoirs, HeldSides, Side
from tests.peri.transport.chemistries import without
from tests.peri.transport.columns import medium_of

LENGTH = 1e-3
THERMAL = 1e3 * GAS_CONSTANT * 298.15 / FARADAY
"""R T / F at 25 degC, mV."""


def salts():
    """Sodium, hydrogen and chloride at 25 degC, with water's own ions."""
    return without("nacl", ("MgOH",), 25.0)


def row(nodes: int, m: int, sides: int = 2) -> HeldSides:
    """`nodes` free nodes before (one side) or between (two) held ones."""
    h, first = LENGTH / nodes, m if sides == 2 else 0
    place = np.arange(nodes + m + first) - first
    side = np.where(place < 0, 2, np.where(place >= nodes, 1, 0))
    stencil = diffusion_stencil(box_lattice([0.0], [place.size * h], h), m * h)
    return HeldSides(stencil, np.ones(place.size, bool), side)


def held(totals: dict[str, float], **changes) -> Side:
    return Side(medium_of(salts(), totals, "ideal"), **changes)


def sound(liquid: BetweenReservoirs, state: LiquidState, source: np.ndarray) -> None:
    """Neutral, positive, and every component booked."""
    strength = 0.5 * liquid.chemistry.charge**2 @ state.concentration
    assert (np.abs(state.net_charge) <= 1e-12 * strength).all()
    assert state.concentration.min() >= 0
    assert liquid.balance(state, source).max() < 1e-10


@pytest.mark.parametrize(
    ("nodes", "m", "form"), [(40, 1, "sqra"), (120, 3, "sqra"), (120, 3, "sg")]
)
def test_acid_against_salt_of_equal_concentration(nodes: int, m: int, form: str) -> None:
    # Henderson's value is exact here, and the potential is linear.
    space, none = row(nodes, m), np.zeros(nodes)
    sides = [held({"Cl": 100.0}), held({"Na": 100.0, "Cl": 100.0}, potential=None)]
    liquid = BetweenReservoirs(space, sides, options=TransportOptions(flux_form=form))
    state = liquid.solve(none)
    chem, place = liquid.chemistry, np.arange(nodes)
    h, na, cl = (chem.diffusivity[chem.index(n)] for n in ("H", "Na", "Cl"))
    exact = THERMAL * np.log((h + cl) / (na + cl))
    volt = 1e3 * liquid.potential(state)
    assert exact == pytest.approx(31.2524, abs=1e-4)
    assert volt[1] - volt[0] == pytest.approx(exact, abs=2e-4)  # measured 6e-5
    phi = 1e3 * liquid.thermal_voltage * state.psi
    # Measured 5e-7 with nearest neighbours, 0.0181 mV with a horizon of three.
    assert np.abs(phi - np.polyval(np.polyfit(place, phi, 1), place)).max() < 0.02
    assert np.abs(liquid.current(state)).max() < 1e-7
    sound(liquid, state, none)


def test_a_cation_electrode_at_nine_tenths_of_the_limiting_current() -> None:
    # The left wall releases sodium and stops chloride; what is held on the right is the wall where
    # sodium goes, so that 100 mol/m3 stand in the middle.
    chem, nodes = salts(), 80
    na = chem.components.index("Na")
    limiting = 4.0 * FARADAY * chem.diffusivity[na] * 100.0 / LENGTH
    assert limiting == pytest.approx(51.330, abs=1e-3)
    current = 0.9 * limiting
    space = row(nodes, 1, sides=1)
    liquid = BetweenReservoirs(
        space, [held({"Na": 10.0, "Cl": 10.0})], options=TransportOptions(flux_form="sg")
    )
    liquid.beside = np.zeros((len(chem.components), nodes))
    liquid.beside[na, 0] = current / FARADAY / (LENGTH / nodes)
    state = liquid.solve(np.zeros(nodes))
    sound(liquid, state, np.zeros(nodes))
    salt = state.concentration[na]
    # Nearest neighbours: node 0 is a whole LENGTH from the first held node. Measured 2e-4 and 7e-5,
    # and 1.04e-3 at most of the local salt, near its lowest.
    assert salt[0] == pytest.approx(190.0, rel=1e-3)
    assert 1e3 * liquid.thermal_voltage * state.psi[0] == pytest.approx(75.650, rel=1e-3)
    assert salt == pytest.approx(190.0 - 180.0 * np.arange(nodes) / nodes, rel=1.2e-3)
    assert liquid.current(state)[0] == pytest.approx(current, rel=1e-10)
    chloride = liquid.received(state)[0, chem.components.index("Cl")]
    assert abs(chloride) < 1e-10 * current / FARADAY


def test_a_uniform_salt_obeys_ohms_law() -> None:
    sides = [held({"Na": 100.0, "Cl": 100.0}, potential=v) for v in (0.0, 1e-3)]
    liquid = BetweenReservoirs(row(40, 1), sides)
    state = liquid.solve(np.zeros(40))
    d = liquid.chemistry.diffusivity[[liquid.chemistry.index(n) for n in ("Na", "Cl")]]
    conductivity = FARADAY**2 / (GAS_CONSTANT * 298.15) * 100.0 * d.sum()
    wanted = conductivity * 1e-3 / (LENGTH * 41 / 40)
    # The square-root flux is 2 sinh(u/2)/u of it.
    assert liquid.current(state) == pytest.approx([wanted, -wanted], rel=1e-5)
    sound(liquid, state, np.zeros(40))


def square() -> tuple[HeldSides, int]:
    """A square of liquid with a side held at the left, one at the right, one at the top."""
    size, reach, h = 16, 2, LENGTH / 12
    x, y = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
    side = np.where(x < reach, 1, np.where(x >= size - reach, 2, 0))
    side[(side == 0) & (y >= size - reach) & (x > 5) & (x < 10)] = 3
    lattice = box_lattice([0.0, 0.0], [size * h, size * h], h)
    space = HeldSides(diffusion_stencil(lattice, reach * h), np.ones((size, size), bool), side)
    return space, space.n


def test_currents_of_three_sides_add_up_to_nothing() -> None:
    space, n = square()
    sides = [
        held({"Na": 100.0, "Cl": 100.0}),
        held({"Cl": 50.0}, potential=None),
        held({"Na": 20.0, "Cl": 30.0}, potential=None, current=2e-4),
    ]
    liquid = BetweenReservoirs(space, sides)
    state = liquid.solve(np.zeros(n))
    current, potential = liquid.current(state), liquid.potential(state)
    assert current[1:] == pytest.approx([0.0, 2e-4], abs=1e-11)
    assert current[0] == pytest.approx(-2e-4, abs=1e-11)
    assert potential[0] == 0.0 and np.abs(potential[1:]).min() > 1e-3
    sound(liquid, state, np.zeros(n))
    # Held at the potentials that were found, the sides pass the same currents.
    again = [
        dataclasses.replace(s, potential=float(v), current=0.0)
        for s, v in zip(sides, potential, strict=True)
    ]
    given = BetweenReservoirs(space, again)
    assert given.current(given.solve(np.zeros(n))) == pytest.approx(current, abs=1e-10)


def test_what_is_no_boundary_is_refused() -> None:
    salt = held({"Na": 10.0, "Cl": 10.0})
    floating = dataclasses.replace(salt, potential=None)
    with pytest.raises(ValueError, match="sides: 1 for a liquid that has 2"):
        BetweenReservoirs(row(10, 1), [salt])
    with pytest.raises(ValueError, match="all of them float; one must have a potential"):
        BetweenReservoirs(row(10, 1), [floating, floating])
    with pytest.raises(ValueError, match="a current of 1 and a potential; one follows"):
        held({"Na": 1.0, "Cl": 1.0}, current=1.0)
    with pytest.raises(ValueError, match="its potential is inf; it must be finite"):
        held({"Na": 1.0, "Cl": 1.0}, potential=np.inf)
    with pytest.raises(ValueError, match="closure: 'none' between reservoirs; allowed is electro"):
        BetweenReservoirs(row(10, 1), [salt, salt], options=TransportOptions(closure="none"))
    real = Side(medium_of(salts(), {"Na": 10.0, "Cl": 10.0}))
    with pytest.raises(ValueError, match="side 2 has other activity coefficients than side 1"):
        BetweenReservoirs(row(10, 1), [salt, real])
    place, lattice = np.arange(9), box_lattice([0.0], [9.0], 1.0)
    for side, says in (
        (np.where(place < 3, 1, np.where(place < 6, 2, 0)), "bonds join side 1 to another"),
        (np.where(place < 3, 2, 0), "no liquid node is of side 1 of 2"),
    ):
        with pytest.raises(ValueError, match=says):
            HeldSides(diffusion_stencil(lattice, 2.0), np.ones(9, bool), side)
