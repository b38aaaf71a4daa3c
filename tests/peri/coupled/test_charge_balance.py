"""Anodes and cathodes apart: one potential of the metal, currents through the ions, all booked."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import brentq

import perilife_data
from peri.corrosion.electrode_kinetics import ElectrodeKinetics
from peri.corrosion.kinetics import ConstantRate, Exposed
from peri.corrosion.metal.solids import Solid
from peri.corrosion.scene import CorrosionScene
from peri.coupled.bath import Bath
from peri.coupled.charge_balance import ELECTRONS
from peri.coupled.degradation import Degradation
from peri.engine.constants import FARADAY, GAS_CONSTANT
from peri.engine.lattice import ball, box_lattice
from peri.engine.march.marching import TimeStepping, march
from peri.transport.chemistry.speciation import Solution, speciate
from peri.transport.chemistry.species import Chemistry
from peri.transport.nernst_planck import TransportOptions
from peri.transport.stored import StoredLiquid
from tests.peri.coupled.test_degradation import medium
from tests.peri.coupled.test_vessels import BARE, DAY, HOUR, crumb

ACTIVE = ElectrodeKinetics(1e-2, 1e-5, -2.0, -0.9, balance="mixed")
NOBLE = ElectrodeKinetics(1e-7, 1e-3, -2.0, -0.9, balance="mixed")
SOLID, FLUX, LENGTH, REACH = 66082.4, 1e-6, 1e-3, 3


def brine(salt: float) -> Solution:
    """NaCl (mol/m3) with a little magnesium, ideal."""
    chemistry = Chemistry(perilife_data.load_reaction_set("nacl").at(310.15, ()))
    totals = {"Na": salt, "Cl": 1.002 * salt, "Mg": 1e-3 * salt}
    return speciate(chemistry, chemistry.totals(totals), "ideal")


def cell(nodes: int, salt: float, balance: str = "mixed") -> tuple[Degradation, float, float]:
    """An active and a noble plate 1 mm apart, after 1 ms; anodic current density and the drop, V.

    The liquid is as it was at first: the current has moved less than 1e-3 of its salt.
    """
    laws = [dataclasses.replace(law, balance=balance) for law in (ACTIVE, NOBLE)]
    place, whole = np.arange(nodes + 2 * REACH), nodes + 2 * REACH
    phase = np.where(place < REACH, 1, np.where(place >= nodes + REACH, 2, 0)).astype(np.uint8)
    h = LENGTH / nodes
    scene = CorrosionScene(
        box_lattice([0.0], [whole * h], h), REACH * h, phase > 0, boundary="no_flux",
        solid_concentration=SOLID, saturation_concentration=6.6, liquid_diffusivity=1e-9,
        dissolution_flux=FLUX, kinetics=laws[0], phase=phase,
        solids=(
            Solid(SOLID, kinetics=laws[0]),
            Solid(SOLID, rate=NOBLE.free_current / ACTIVE.free_current, kinetics=laws[1]),
        ),
    )  # fmt: skip
    problem = Degradation(scene, brine(salt), TransportOptions())
    done = march(problem, [1e-3], TimeStepping("backward_euler", step=1e-3))
    assert done.outputs[-1]["net_charge"] < 1e-12
    fields, discrete = done.state.fields, problem.discrete
    seen = {n: fields[f"seen_{n}"] for n in ("potential", "ph", "magnesium")}
    strengths = problem.charge_balance.strengths(
        problem.surroundings, fields["concentration"], fields["theta"]
    )
    anodic, cathodic = problem.charge_balance.rates(discrete.box_phase, seen)
    flows = ELECTRONS * FARADAY * scene.lattice.cell_volume * strengths * (anodic - cathodic)
    assert abs(flows.sum()) < 1e-6 * np.abs(flows).sum()
    own = discrete.sum.crop(discrete.put(seen["potential"]))
    current = float(flows[discrete.box_phase == 1].sum())
    return problem, current, float(own[nodes + REACH] - own[REACH - 1])


def exact(resistance: float) -> tuple[float, float]:
    """Current density (A/m2) and drop (V) of the two plates behind a resistance (ohm m2)."""
    scale = ELECTRONS * FARADAY * FLUX / ACTIVE.free_current

    def net(law: ElectrodeKinetics, potential: float) -> float:
        anodic, cathodic = law.currents(np.array(potential), 7.0, 0.0)
        return scale * float(anodic - cathodic)

    def plates(current: float) -> float:
        low, high = (
            brentq(lambda e, law=law, i=i: net(law, e) - i, -4.0, 1.0, xtol=1e-15)
            for law, i in ((ACTIVE, current), (NOBLE, -current))
        )
        return high - low

    current = brentq(lambda i: plates(i) - resistance * i, 0.0, 1e3, xtol=1e-15)
    return current, resistance * current


def resistance(salt: float) -> float:
    """Of the liquid between the plates, ohm m2."""
    liquid = brine(salt)
    mobile = liquid.chemistry.charge**2 * liquid.chemistry.diffusivity @ liquid.concentration[:, 0]
    return LENGTH * GAS_CONSTANT * 310.15 / (FARADAY**2 * float(mobile))


def test_without_resistance_the_potential_is_that_of_two_tafel_laws_together() -> None:
    salt = 1e4
    problem, current, drop = cell(10, salt)
    # E where the sums of both plates' exponentials are equal, in closed form.
    thermal = GAS_CONSTANT * 310.15 / FARADAY
    ratio = (1e-5 + 1e-3) / (1e-2 + 1e-7)
    potential = (thermal * np.log(ratio) - 2.0 - 0.5 * 0.9) / 1.5
    found = problem.discrete.surface["potential"][problem.discrete.box_metal]
    assert found.mean() == pytest.approx(potential, abs=2e-5)  # measured 2e-6
    wanted, small = exact(resistance(salt))
    assert current == pytest.approx(wanted, rel=5e-4)  # measured 3e-4
    assert 0 < drop < 5e-5 and small < 5e-5


@pytest.mark.slow
def test_a_resistance_between_anode_and_cathode_holds_them_back() -> None:
    salt, errors = 3.0, []
    wanted, drop = exact(resistance(salt))
    free = exact(0.0)[0]
    assert 0.4 * free < wanted < 0.6 * free and 0.04 < drop < 0.05  # 2.25 of 4.13 A/m2, 49 mV
    for nodes in (10, 20):
        _, current, found = cell(nodes, salt)
        errors.append([current / wanted - 1.0, found / drop - 1.0])
    orders = np.log2(np.array(errors[0]) / errors[1])
    # Measured 2.9 and 5.9 % with 20 nodes, of first order: a current enters over a horizon.
    assert (orders > 0.8).all() and (orders < 1.3).all()
    assert (np.abs(errors[1]) < [0.04, 0.07]).all()


@pytest.mark.slow
def test_a_large_resistance_leaves_each_plate_near_its_own_potential() -> None:
    wanted, drop = exact(resistance(0.3))
    assert wanted < 0.17 * exact(0.0)[0] and drop > 0.14  # 5.4 RT/F, half of what drives it
    _, current, found = cell(20, 0.3)
    # Measured 6 and 4 %, as of a smaller resistance: a current enters over a horizon.
    assert current == pytest.approx(wanted, rel=0.08) and found == pytest.approx(drop, rel=0.06)


@pytest.mark.slow
def test_plates_in_next_to_pure_water_settle() -> None:
    # 0.03 mol/m3: ten RT/F between the plates, of which a bond of the coarser lattice sees 1.5.
    wanted, drop = exact(resistance(0.03))
    assert wanted < 0.03 * exact(0.0)[0] and drop > 0.24
    errors = []
    for nodes in (20, 40):
        _, current, found = cell(nodes, 0.03)
        errors.append([current / wanted - 1.0, found / drop - 1.0])
    orders = np.log2(np.array(errors[0]) / errors[1])
    # Measured 12 and 4.3 % of the current, 3.0 and 1.3 % of the drop.
    assert (orders > 0.8).all() and (np.abs(errors[1]) < [0.06, 0.02]).all()


@pytest.fixture
def rounds(monkeypatch) -> list[int]:
    """Rounds of every solution of a liquid that stores."""
    counted, advance = [], StoredLiquid.advance

    def counting(self, *given, **more):
        state = advance(self, *given, **more)
        counted.append(state.sweeps)
        return state

    monkeypatch.setattr(StoredLiquid, "advance", counting)
    return counted


def test_a_drop_of_ten_thermal_voltages_takes_few_rounds(rounds: list[int]) -> None:
    _, current, drop = cell(20, 0.03)
    # What 62 solutions of 55 rounds each found, without the response of ohmic.py.
    assert current == pytest.approx(0.1313922, rel=1e-6) and drop == pytest.approx(0.2424696)
    assert len(rounds) <= 8 and sum(rounds) <= 180  # measured 6 and 123


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "potential", "charge", "solutions"),
    [
        ({"balance": "mixed"}, -1.6649498, 0.0, 10),
        ({"balance": "applied", "applied_current": -1e-3}, -1.6976302, -1e-6, 12),
        ({"balance": "applied", "applied_potential": -1.3}, -1.3, 2.930498e-5, 22),
    ],
)
def test_two_blocks_in_refreshed_water_settle(
    rounds: list[int], how: dict, potential: float, charge: float, solutions: int
) -> None:
    # 0.3 mol/m3; the third loses up to 0.4 V in the liquid, and is what 21 solutions of 65 rounds
    # each found without the response of ohmic.py (the others did not end).
    laws = [dataclasses.replace(law, **how) for law in (ACTIVE, NOBLE)]
    phase = np.zeros((16, 16), np.uint8)
    phase[5:8, 5:11], phase[9:11, 5:11] = 1, 2
    scene = CorrosionScene(
        box_lattice([0.0, 0.0], [1.6e-3, 1.6e-3], 1e-4), 2e-4, phase > 0, boundary="refreshed",
        solid_concentration=SOLID, saturation_concentration=6.6, liquid_diffusivity=1e-9,
        dissolution_flux=FLUX, kinetics=laws[0], phase=phase,
        solids=(
            Solid(SOLID, kinetics=laws[0]),
            Solid(SOLID, rate=NOBLE.free_current / ACTIVE.free_current, kinetics=laws[1]),
        ),
    )  # fmt: skip
    problem = Degradation(scene, brine(0.3), TransportOptions(), storage=True)
    done = march(problem, [1e-3], TimeStepping("backward_euler", step=1e-3))
    assert done.history["metal_potential"][-1] == pytest.approx(potential, abs=1e-6)
    assert done.history["applied_charge"][-1] == pytest.approx(charge, rel=1e-6, abs=1e-15)
    assert done.outputs[-1]["net_charge"] < 1e-12 and done.outputs[-1]["balance"] < 1e-10
    assert len(rounds) <= solutions  # measured 8, 9 and 18


FREE = ElectrodeKinetics(1e-3, 1e-2, -2.0, -0.9, ph_reference=7.5724)


def marched(law: ElectrodeKinetics, storage: bool = False, steps: int = 2):
    problem = Degradation(
        crumb(1e-6, half=0.7e-3, kinetics=law), medium("sbf"), TransportOptions(), storage=storage
    )
    return problem, march(problem, [DAY], TimeStepping("sdirk2", step=DAY / steps))


def charge_left(problem: Degradation, state) -> tuple[float, float]:
    """Charge that the ions carry out of the liquid, and that the metal gives it, mol/s."""
    found = problem.liquid_at(state)
    liquid = problem.surroundings.liquid
    left = liquid.chemistry.component_charge @ liquid.leaving(found)
    return float(left), problem.surroundings.space.total(problem._carry(state.fields))


def test_on_a_uniform_surface_mixed_is_local() -> None:
    # Without a dependence on pH every node has the same potential of its own; what is left is the
    # diffusion potential, 1e-5 V.
    apart = dataclasses.replace(FREE, balance="mixed")
    (_, one), (problem, other) = marched(FREE), marched(apart)
    assert other.history["volume_loss"][-1] == pytest.approx(
        one.history["volume_loss"][-1], rel=1e-6
    )
    rest = float(FREE.corrosion_potential(7.5724, 0.0))
    assert other.history["metal_potential"] == pytest.approx(rest, abs=2e-5)
    assert np.abs(other.history["applied_charge"]).max() < 1e-18
    left, given = charge_left(problem, other.state)
    assert max(abs(left), abs(given)) < 1e-10 * other.history["hydrogen_amount"][-1] / DAY
    assert other.outputs[-1]["balance"] < 1e-10 and other.outputs[-1]["net_charge"] < 1e-12


@pytest.mark.parametrize("storage", [pytest.param(True, marks=pytest.mark.slow), False])
def test_an_applied_potential_sends_its_current_through_the_refreshed_layer(storage) -> None:
    law = dataclasses.replace(FREE, balance="applied", applied_potential=-1.62)
    problem, done = marched(law, storage)
    history, (left, given) = done.history, charge_left(problem, done.state)
    assert given < 0 and left == pytest.approx(given, rel=1e-10)
    lost = history["metal_amount"][0] - history["metal_amount"][-1]
    charge = history["applied_charge"][-1]
    assert charge < -0.005  # C
    # What the anode gives less what the cathode takes is the current: z F mole by mole.
    passed = ELECTRONS * FARADAY * (lost - history["hydrogen_amount"][-1])
    assert passed == pytest.approx(charge, rel=1e-10)
    assert done.outputs[-1]["balance"] < 1e-10 and done.outputs[-1]["net_charge"] < 1e-12
    # Far enough from E_0 the metal dissolves by Tafel's law of the node's potential: the field of
    # the liquid, 0.2 mV, is all that differs from -1.62 V.
    rate = law.rates(np.array(-1.62), 7.57, 0.0)[0]
    alone = marched(FREE)[1].history["metal_amount"]
    assert lost / (alone[0] - alone[-1]) == pytest.approx(float(rate), rel=0.02)


def test_the_current_of_a_potential_gives_the_potential_of_the_current() -> None:
    held = dataclasses.replace(FREE, balance="applied", applied_potential=-1.58)
    problem, done = marched(held, steps=1)
    current = FARADAY * charge_left(problem, done.state)[1]
    given = dataclasses.replace(FREE, balance="applied", applied_current=current)
    again = marched(given, steps=1)[1]
    assert again.history["metal_potential"][-1] == pytest.approx(-1.58, abs=1e-4)
    assert again.history["applied_charge"][-1] == pytest.approx(DAY * current, rel=1e-9)


@pytest.mark.slow
def test_mixed_in_a_closed_vessel_keeps_every_element_and_no_charge() -> None:
    law = dataclasses.replace(FREE, balance="mixed", ph_order=0.3, ph_reference=6.811)
    scene = crumb(2e-6, boundary="no_flux", kinetics=law)
    problem = Degradation(scene, medium("nacl", ("brucite",)))
    done = march(problem, [HOUR], TimeStepping("sdirk2", step=0.5 * HOUR))
    assert done.history["element_error"].max() < 1e-10
    assert done.outputs[-1]["net_charge"] < 1e-12 and done.outputs[-1]["lowest"] > 0
    assert np.abs(done.history["applied_charge"]).max() < 1e-15


def shell() -> CorrosionScene:
    """A hollow ball: the liquid inside is joined to that outside by nothing."""
    lattice = box_lattice([-0.9e-3] * 3, [0.9e-3] * 3, 0.1e-3)
    metal = ball(lattice, (0, 0, 0), 0.5e-3) & ~ball(lattice, (0, 0, 0), 0.12e-3)
    law = dataclasses.replace(FREE, balance="mixed")
    scene = crumb(1e-6, half=0.9e-3, kinetics=law)
    return dataclasses.replace(scene, metal=metal, domain=ball(lattice, (0, 0, 0), 0.9e-3))


@pytest.mark.parametrize(
    ("changes", "options", "says"),
    [
        ({"boundary": "no_flux"}, {}, "'applied' in a closed vessel, which no current leaves"),
        ({}, {"options": BARE}, "closure: 'none' with balance 'applied', whose current needs"),
        ({}, {"bath": Bath(1e-6)}, "'applied' with a bath of finite volume, which the counter"),
        (
            {"solids": (Solid(SOLID, kinetics=ConstantRate()), Solid(SOLID))},
            {},
            "some solids of the metal have electrodes and others none",
        ),
        (
            {"solids": (Solid(SOLID, kinetics=ACTIVE), Solid(SOLID))},
            {},
            "the solids of one metal must have the same",
        ),
    ],
)
def test_currents_without_a_way_are_refused(changes: dict, options: dict, says: str) -> None:
    law = dataclasses.replace(FREE, balance="applied", applied_potential=-1.6)
    scene = crumb(1e-6, kinetics=law)
    if "solids" in changes:
        changes["phase"] = scene.metal.astype(np.uint8)
    with pytest.raises(ValueError, match=says):
        Degradation(dataclasses.replace(scene, **changes), medium("nacl"), **options)


def test_liquid_in_two_parts_has_no_potential_of_the_whole() -> None:
    with pytest.raises(ValueError, match="nodes of the liquid are cut off from the rest"):
        Degradation(shell(), medium("nacl"), storage=True)


def test_metal_that_would_plate_out_is_not_computed() -> None:
    law = dataclasses.replace(ACTIVE, balance="applied", applied_potential=-2.2)
    with pytest.raises(ValueError, match="would plate out on it"):
        law.rate(Exposed(ph=7.0, potential=np.array([-2.2]), magnesium=np.array([10.0])))
