"""The quasi-steady liquid: known profiles, minerals, neutrality, balances, refusals."""

import dataclasses

import numpy as np
import pytest

import perilife_data
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import ball, box_lattice
from peri.transport.chemistry.species import Chemistry
from peri.transport.liquid import LiquidSpace
from peri.transport.nernst_planck import QuasiSteadyLiquid, TransportOptions
from tests.peri.transport.chemistries import SALINE, SBF, chemistry, without
from tests.peri.transport.columns import MAGNESIUM, column, medium_of

MG = 3
"""Number of the component Mg in the set `sbf`."""


def with_minerals(name: str, **changes: dict[str, float]) -> Chemistry:
    """A shipped set at 37 degC with the minerals named, some of their numbers changed."""
    numbers = perilife_data.load_reaction_set(name).at(310.15, tuple(changes))
    minerals = {n: dataclasses.replace(m, **changes[n]) for n, m in numbers.minerals.items()}
    return Chemistry(dataclasses.replace(numbers, minerals=minerals))


def total(liquid: QuasiSteadyLiquid, state, component: int) -> np.ndarray:
    return liquid.chemistry.stoichiometry[:, component] @ state.concentration


def at_the_surface(values: dict[int, float]) -> float:
    """The value for spacing zero: the error is first order, halved from grid to grid."""
    coarse, middle, fine = (values[n] for n in sorted(values))
    assert 1.6 < (coarse - middle) / (middle - fine) < 2.4  # the order is there
    return 2 * fine - middle


# flux, mol/m2/s; surface pH; magnesium, mol/m3; potential, mV: exact profiles of the local
# equations (an initial value problem in 1D, 0.5 mm, 37 degC, activities of the medium)
@pytest.mark.parametrize(
    ("name", "totals", "flux", "ph", "magnesium", "millivolt"),
    [
        ("sbf", SBF, 1e-7, 7.5845, 0.0575, 0.0032),
        ("sbf", SBF, 1e-6, 7.7038, 0.5763, 0.0305),
        ("sbf", SBF, 3e-6, 8.0257, 1.7442, 0.0750),
        ("saline", SALINE, 1e-6, 9.6975, 0.5488, 0.0885),
    ],
)
def test_magnesium_released_into_half_a_millimetre(
    name: str, totals: dict, flux: float, ph: float, magnesium: float, millivolt: float
) -> None:
    chem = chemistry("sbf") if name == "sbf" else without("nacl", ("MgOH",))
    found: dict[str, dict[int, float]] = {"ph": {}, "magnesium": {}, "millivolt": {}}
    for nodes in (80, 160, 320):
        liquid, unit = column(chem, totals, nodes)
        state = liquid.solve(flux * unit)
        found["ph"][nodes] = liquid.ph(state)[0]
        found["magnesium"][nodes] = total(liquid, state, chem.components.index("Mg"))[0]
        found["millivolt"][nodes] = 1e3 * liquid.thermal_voltage * state.psi[0]
        strength = 0.5 * chem.charge**2 @ state.concentration
        assert (np.abs(state.net_charge) <= 1e-12 * strength).all()
        assert liquid.balance(state, flux * unit).max() < 1e-10
        assert state.concentration.min() > 0
    # Measured: 1e-4 in pH, 1e-4 of magnesium, half a unit of the potential's last digit.
    assert at_the_surface(found["ph"]) == pytest.approx(ph, abs=0.001)
    assert at_the_surface(found["magnesium"]) == pytest.approx(magnesium, rel=2e-3)
    assert at_the_surface(found["millivolt"]) == pytest.approx(millivolt, rel=0.02)


def test_without_the_potential_little_changes_and_the_bound_holds() -> None:
    chem = chemistry("sbf")
    (full, unit), (bare, _) = column(chem, SBF), column(chem, SBF, closure="none")
    state, simple = full.solve(1e-6 * unit), bare.solve(1e-6 * unit)
    phi = full.thermal_voltage * np.abs(state.psi).max()
    bound = bare.potential_bound(simple)
    assert phi == pytest.approx(bound, rel=0.02) and phi > 1e-5
    assert np.abs(full.ph(state) - bare.ph(simple)).max() < 1e-3
    concentration = bare.neutral_concentration(simple)
    assert np.abs(chem.charge @ concentration).max() < 1e-12 * 147
    assert chem.names[bare.inert] == "Cl"
    assert simple.net_charge[0] > 0.1


def test_poisson_with_permittivity_is_neutral_to_a_millionth() -> None:
    chem = chemistry("sbf")
    (one, unit), (other, _) = column(chem, SBF), column(chem, SBF, closure="poisson")
    a, b = one.solve(1e-6 * unit), other.solve(1e-6 * unit)
    # Measured 1e-10: (spacing / Debye length)^2 is 2e8.
    assert b.psi == pytest.approx(a.psi, rel=1e-6, abs=1e-6 * np.abs(a.psi).max())
    assert b.concentration == pytest.approx(a.concentration, rel=1e-6)
    assert np.abs(b.net_charge).max() > 0


def test_the_published_closure_switches_migration_off() -> None:
    chem = chemistry("sbf")
    published, unit = column(chem, SBF, closure="as_published")
    simple, _ = column(chem, SBF, closure="none")
    a, b = published.solve(1e-6 * unit), simple.solve(1e-6 * unit)
    assert 0 < np.abs(a.psi).max() < 1e-3 * np.abs(b.net_charge).max() / 300
    assert a.concentration == pytest.approx(b.concentration, rel=1e-5)


def test_scharfetter_gummel_and_mean_agree_with_the_default_in_weak_fields() -> None:
    chem = without("nacl", ("MgOH",))
    default, unit = column(chem, SALINE)
    state = default.solve(1e-6 * unit)
    for form in ("sg", "mean"):
        other, _ = column(chem, SALINE, flux_form=form)
        result = other.solve(1e-6 * unit)
        assert result.psi == pytest.approx(state.psi, rel=1e-5)


# --- minerals -----------------------------------------------------------------------------


@pytest.mark.parametrize("closure", ["none", "electroneutral"])
def test_brucite_takes_what_exceeds_its_onset(closure: str) -> None:
    chem = without("nacl", ("MgOH",), 37.0, ("brucite",))
    shares, below = [], []
    onset = 1.3827e-6  # closed form of the local equations, no potential
    for nodes in (80, 160):
        liquid, unit = column(chem, SALINE, nodes, closure=closure)
        below.append(liquid.solve(0.9 * onset * unit))
        state = liquid.solve(1e-5 * unit)
        space = liquid.space
        shares.append(space.total(state.rates[0]) / space.total(1e-5 * unit))
        assert np.abs(liquid.saturation_index(state, 0)[state.active[0]]).max() < 1e-9
        assert (liquid.saturation_index(state, 0) < 1e-9).all()
        assert (state.rates[0] >= 0).all() and (state.rates[0][1:] == 0).all()
        assert liquid.balance(state, 1e-5 * unit).max() < 1e-10
    assert all((state.rates == 0).all() for state in below)
    assert 2 * shares[1] - shares[0] == pytest.approx(1 - onset / 1e-5, abs=1e-3)  # 0.8617


def test_fast_kinetics_ends_in_equilibrium_over_fifteen_decades() -> None:
    equilibrium, unit = column(with_minerals("nacl", brucite={}), SALINE, closure="none")
    source = 1e-5 * unit
    exact = equilibrium.solve(source)
    share = []
    for decade in range(-12, 4):
        chem = with_minerals(
            "nacl",
            brucite={"kind": "kinetic", "rate_constant": 10.0**decade, "specific_surface": 1.0},
        )
        liquid, _ = column(chem, SALINE, closure="none")
        state = liquid.solve(source)
        share.append(liquid.space.total(state.rates[0]) / liquid.space.total(source))
        assert state.concentration.min() > 0
        assert liquid.balance(state, source).max() < 1e-10
    assert (np.diff(share) > 0).all() and share[0] < 1e-9
    wanted = equilibrium.space.total(exact.rates[0]) / equilibrium.space.total(source)
    assert share[-1] == pytest.approx(wanted, rel=1e-4)


def test_a_kinetic_mineral_waits_for_its_nucleation_index() -> None:
    numbers = {"kind": "kinetic", "rate_constant": 1e-4, "specific_surface": 1.0}
    low = with_minerals("sbf", calcite={**numbers, "nucleation_index": 1.05})
    high = with_minerals("sbf", calcite={**numbers, "nucleation_index": 1.5})
    for chem, forms in ((low, True), (high, False)):
        liquid, unit = column(chem, SBF)
        state = liquid.solve(1e-6 * unit)
        assert (state.rates[0].max() > 0) == forms
    # Once there, it grows below the index too.
    amounts = np.ones((1, liquid.space.n))
    again = liquid.solve(1e-6 * unit, amounts=amounts, step=3600.0)
    assert again.rates[0].max() > 0


@pytest.mark.parametrize("kind", ["equilibrium", "kinetic"])
def test_no_more_dissolves_than_is_there(kind: str) -> None:
    change = (
        {"kind": kind, "rate_constant": 1e3, "specific_surface": 1.0} if kind == "kinetic" else {}
    )
    chem = with_minerals("nacl", brucite=change)
    liquid, unit = column(chem, SALINE, closure="none")
    amounts, step = np.zeros((1, liquid.space.n)), 1000.0
    amounts[0, 0], amounts[0, 5] = 1e-4, 1000.0
    state = liquid.solve(1e-9 * unit, amounts=amounts, step=step)
    left = amounts[0] + step * state.rates[0]
    if kind == "kinetic":  # the region of brucite is the whole liquid in both
        assert left.min() > -1e-12
    assert left[0] == pytest.approx(0.0, abs=1e-12) and 100 < left[5] < 999
    assert (left[amounts[0] == 0] >= 0).all()
    assert liquid.balance(state, 1e-9 * unit).max() < 1e-10


def test_minerals_in_the_same_place_are_all_in_balance() -> None:
    chem = with_minerals(
        "sbf",
        brucite={},
        magnesite={"region": "surface"},
        calcite={"rate_constant": 1e-4, "nucleation_index": 1.0},
        hydroxyapatite={"rate_constant": 1e-6, "nucleation_index": 8.0},
    )
    liquid, unit = column(chem, SBF)
    source = 2e-5 * unit
    state = liquid.solve(source)
    index = np.array([liquid.saturation_index(state, i) for i in range(4)])
    assert (state.rates.max(axis=1) > 0).sum() >= 3
    assert (index[:2, 0] < 1e-6).all()
    assert (np.abs(index[:2] * state.rates[:2]) < 1e-9 * state.rates.max()).all()
    for i in (2, 3):
        rate = chem.minerals[i].rate * np.log(10) * index[i]
        grows = state.rates[i] > 0
        assert state.rates[i][grows] == pytest.approx(rate[grows], rel=1e-6)
    assert liquid.balance(state, source).max() < 1e-9
    assert (np.abs(state.net_charge) < 1e-12 * 147).all()


# --- in three dimensions ------------------------------------------------------------------


def body(chem: Chemistry, totals: dict, **options) -> tuple[QuasiSteadyLiquid, np.ndarray]:
    """A ball of metal in a ball of liquid; and the source of a unit flux."""
    h = 0.1e-3
    lattice = box_lattice([-0.8e-3] * 3, [0.8e-3] * 3, h)
    domain, metal = ball(lattice, (0, 0, 0), 0.8e-3), ball(lattice, (0, 0, 0), 0.3e-3)
    outer = domain & ~ball(lattice, (0, 0, 0), 0.6e-3)
    stencil = diffusion_stencil(lattice, 2 * h)
    space = LiquidSpace(stencil, domain & ~metal, outer)
    wet = space.gather(space.sum(space.sum.pad(metal.astype(float))))
    liquid = QuasiSteadyLiquid(
        space, medium_of(chem, totals), MAGNESIUM, wet > 0, TransportOptions(**options)
    )
    return liquid, wet / stencil.mean_strength()


def test_a_body_in_three_dimensions_is_neutral_positive_and_conservative() -> None:
    chem = with_minerals("nacl", brucite={})
    liquid, unit = body(chem, SALINE)
    source = 1e-5 * unit
    state = liquid.solve(source)
    assert state.rates[0].max() > 0 and liquid.ph(state).max() > 9
    assert state.concentration.min() > 0
    strength = 0.5 * chem.charge**2 @ state.concentration
    assert (np.abs(state.net_charge) <= 1e-12 * strength).all()
    assert liquid.balance(state, source).max() < 1e-10
    again = liquid.solve(source, start=state)
    assert again.concentration == pytest.approx(state.concentration, rel=1e-8)


def test_many_random_releases_stay_positive_neutral_and_conservative() -> None:
    rng = np.random.default_rng(8)
    for scene in range(25):
        chem = with_minerals("nacl", brucite={}) if scene % 2 else chemistry("sbf")
        totals = SALINE if scene % 2 else SBF
        liquid, _ = column(chem, totals, nodes=int(rng.integers(4, 40)), m=int(rng.integers(1, 4)))
        n = liquid.space.n
        # mol/m3/s; weaker ones drown in the round-off of the 142 mol/m3 of salt
        source = 10.0 ** rng.uniform(-3, 0.5) * rng.random(n) * (rng.random(n) < 0.3)
        state = liquid.solve(source)
        strength = 0.5 * chem.charge**2 @ state.concentration
        assert (state.concentration >= 0).all(), scene
        assert (np.abs(state.net_charge) <= 1e-12 * strength).all(), scene
        assert liquid.balance(state, source).max() < 1e-10, scene


# --- refusals -----------------------------------------------------------------------------


def test_liquid_without_a_way_out_is_refused() -> None:
    lattice = box_lattice([0.0], [30.0], 1.0)
    liquid = np.ones(30, bool)
    liquid[8:14] = False  # a wall thicker than the horizon
    refreshed = np.arange(30) >= 27
    space = LiquidSpace(diffusion_stencil(lattice, 3.0), liquid, refreshed)
    assert space.cut_off().sum() == 8
    with pytest.raises(ValueError, match="8 nodes are cut off from the refreshed medium"):
        QuasiSteadyLiquid(
            space, medium_of(chemistry("nacl"), SALINE), MAGNESIUM, np.zeros(space.n, bool)
        )


def test_a_charged_release_is_refused() -> None:
    liquid, _ = column(chemistry("nacl"), SALINE)
    with pytest.raises(ValueError, match="carry a charge of \\+2 per mole of metal"):
        QuasiSteadyLiquid(liquid.space, liquid.medium, {"Mg": 1.0}, np.zeros(liquid.space.n, bool))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"flux_form": "upwind"}, "flux_form: 'upwind'; allowed are sqra, sg"),
        ({"closure": "neutral"}, "closure: 'neutral'; allowed are electroneutral"),
        ({"tolerance": 0.0}, "tolerance: 0.0; it must be between 0 and 1"),
    ],
)
def test_options_are_checked(options: dict, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        TransportOptions(**options)
