"""Composition of closed and open vessels, against PHREEQC and against its own equations."""

import math

import numpy as np
import pytest

import perilife_data
from peri.transport.chemistry.activity import check_strength, davies, debye_hueckel, wateq
from peri.transport.chemistry.composition import CompositionError
from peri.transport.chemistry.speciation import speciate
from tests.peri.transport import phreeqc
from tests.peri.transport.chemistries import PAIRS, SALINE, SBF, chemistry, without

ALL = ("brucite", "calcite", "hydroxyapatite")


def with_base(amount: float) -> dict[str, float]:
    """SBF with a strong base (NaOH) or, negative, a strong acid (HCl) added, mol/m3."""
    return {**SBF, "Na": SBF["Na"] + max(amount, 0.0), "Cl": SBF["Cl"] + max(-amount, 0.0)}


# mol/m3 of base and the pH (of PHREEQC with our constants, rounded), so that 2 to 12 is covered
@pytest.mark.parametrize(
    ("base", "about"),
    [(-55, 1.8), (-36, 3.3), (-34, 4.7), (-10, 6.5), (0, 7.6), (10, 8.9), (40, 11.0), (70, 12.0)],
)
@pytest.mark.parametrize("activity", ["davies", "wateq"])
def test_speciation_equals_phreeqc_with_the_same_constants(
    base: float, about: float, activity: str
) -> None:
    chem = chemistry("sbf", 37.0, ALL)
    totals = {**with_base(base), "Mg": 1.5, "Cl": with_base(base)["Cl"] + 3.0}
    text = phreeqc.solution(totals, 37) + phreeqc.punch(chem)
    row = phreeqc.run(text, phreeqc.database(chem, activity))[-1]
    # PHREEQC's B is per angstrom.
    constant = (row["A"], 1e10 * row["B"])
    ours = speciate(chem, chem.totals(totals), activity, constant=constant)
    assert row["pH"] == pytest.approx(about, abs=0.2)
    # Measured: below 1e-10, what PHREEQC's own tolerance leaves.
    assert ours.ph[0] == pytest.approx(row["pH"], abs=1e-9)
    assert ours.strength[0] == pytest.approx(row["mu"], rel=1e-9)
    for name, index in zip(ALL, ours.saturation_index[:, 0], strict=True):
        assert index == pytest.approx(row[name], abs=1e-8)


def test_a_medium_with_tris_has_the_ph_of_its_recipe_and_that_of_phreeqc() -> None:
    medium = perilife_data.load_medium("simulated-body-fluid-tris")
    chem = chemistry(medium.reactions, medium.temperature.si - 273.15, ("hydroxyapatite",))
    totals = {n: s.total_concentration.si for n, s in medium.species.items()}
    for activity in ("davies", "wateq"):
        text = phreeqc.solution(totals, 36.5) + phreeqc.punch(chem)
        row = phreeqc.run(text, phreeqc.database(chem, activity))[-1]
        constant = (row["A"], 1e10 * row["B"])
        ours = speciate(chem, chem.totals(totals), activity, constant=constant)
        assert ours.ph[0] == pytest.approx(row["pH"], abs=1e-9)
        assert ours.saturation_index[0, 0] == pytest.approx(row["hydroxyapatite"], abs=1e-8)
        # The recipe is titrated to pH 7.40 at 36.5 degC: measured 7.399.
        assert ours.ph[0] == pytest.approx(7.40, abs=0.02)


def test_brucite_in_a_closed_vessel_equals_phreeqc_with_the_same_constants() -> None:
    chem = chemistry("nacl", 37.0, ("brucite",))
    row = phreeqc.run(
        phreeqc.solution(SALINE, 37) + "EQUILIBRIUM_PHASES 1\n brucite 0 0\n"
        "REACTION 1\n Mg(OH)2 0.001\n 1\n" + phreeqc.punch(chem, " formed", ', EQUI("brucite")'),
        phreeqc.database(chem),
    )[-1]
    totals = chem.totals({**SALINE, "Mg": 1.0})
    ours = speciate(chem, totals, "davies", minerals=("brucite",), constant=(row["A"], 0.0))
    # PHREEQC grows a little water from what dissolves; measured 2e-7.
    assert ours.ph[0] == pytest.approx(row["pH"], abs=1e-6)
    assert ours.mineral[0, 0] == pytest.approx(row["formed"] * 1e3, rel=1e-5)


def test_constants_are_those_of_phreeqc_dat() -> None:
    """The set against the database it cites: species present at 25 and 37 degC."""
    names = {
        "OH": "OH-", "CO2": "CO2", "HPO4": "HPO4-2", "H2PO4": "H2PO4-", "MgOH": "MgOH+",
        "MgCO3": "MgCO3", "MgPO4": "MgPO4-", "CaCO3": "CaCO3", "CaPO4": "CaPO4-", "NaCO3": "NaCO3-",
    }  # fmt: skip
    for celsius in (25, 37):
        chem = chemistry("sbf", celsius)
        listed = ", ".join(f'LK_SPECIES("{n}")' for n in names.values())
        row = phreeqc.run(
            phreeqc.solution({**SBF, "Mg": 1.0}, celsius, "C(4)")
            + "SELECTED_OUTPUT\n -reset false\nUSER_PUNCH\n -headings "
            + " ".join(names)
            + f"\n 10 PUNCH {listed}\n"
        )[-1]
        for name in names:
            ours = chem.ln_k[chem.index(name)] / math.log(10)
            # The file keeps four decimals.
            assert ours == pytest.approx(row[name], abs=2e-4), (name, celsius)


@pytest.mark.parametrize(("activity", "within"), [("davies", 0.1), ("wateq", 0.05)])
def test_sbf_at_rest_is_what_phreeqc_dat_makes_of_the_totals(activity: str, within: float) -> None:
    chem = chemistry("sbf", 37.0, ("calcite", "hydroxyapatite"))
    solution = speciate(chem, chem.totals(SBF), activity)
    row = phreeqc.run(
        phreeqc.solution(SBF, 37, "C(4)")
        + "SELECTED_OUTPUT\n -reset false\nUSER_PUNCH\n -headings pH calcite hap co2\n"
        ' 10 PUNCH -LA("H+"), SI("Calcite"), SI("Hydroxyapatite"), SI("CO2(g)")\n'
    )[-1]
    assert row["pH"] == pytest.approx(7.5735, abs=1e-4)
    calcite, apatite = solution.saturation_index[:, 0]
    # Measured 0.0011 and 0.017, with WATEQ's law 0.0008 and 0.003.  The apatite has 9 ions of
    # charge 2 and 3, so the difference of Davies' equation adds up to 0.071 (WATEQ's: 0.005).
    assert solution.ph[0] == pytest.approx(row["pH"], abs=0.02)
    assert calcite == pytest.approx(row["calcite"], abs=0.05)
    assert apatite == pytest.approx(row["hap"], abs=within)
    co2 = solution.amount("CO2")[0] * 1e-3 * math.exp(solution.ln_gamma[chem.index("CO2"), 0])
    # Henry's constant of CO2 at 37 degC: 10^-1.5966 (phreeqc.dat)
    assert math.log10(co2) + 1.5966 == pytest.approx(row["co2"], abs=0.01)
    assert row["co2"] == pytest.approx(-1.29, abs=0.01)


@pytest.mark.parametrize(
    ("base", "ph"),
    [(-10, 6.5389), (-5, 6.8822), (-2, 7.2084), (2, 8.0704), (5, 8.5530), (20, 9.4992)],
)
def test_titration_follows_phreeqc_dat(base: float, ph: float) -> None:
    chem = chemistry("sbf")
    # ph: PHREEQC with phreeqc.dat, 37 degC, closed. Measured: 0.003 at most.
    assert speciate(chem, chem.totals(with_base(base))).ph[0] == pytest.approx(ph, abs=0.02)


@pytest.mark.parametrize(("magnesium", "ph"), [(1.0, 8.0549), (5.0, 8.9043)])
def test_magnesium_hydroxide_raises_the_ph_as_in_phreeqc_dat(magnesium: float, ph: float) -> None:
    chem = chemistry("sbf")
    totals = chem.totals({**SBF, "Mg": magnesium})  # neutrality makes it Mg(OH)2
    assert speciate(chem, totals).ph[0] == pytest.approx(ph, abs=0.02)  # measured 0.0044


def test_without_ion_pairs_the_ph_is_off_by_more_than_a_tenth() -> None:
    full, bare = chemistry("sbf"), without("sbf", PAIRS)
    assert speciate(bare, bare.totals(SBF)).ph[0] == pytest.approx(7.6948, abs=1e-3)
    assert speciate(full, full.totals(SBF)).ph[0] == pytest.approx(7.5724, abs=1e-3)


def test_brucite_saturates_saline_where_phreeqc_dat_says() -> None:
    chem = chemistry("nacl", 37.0, ("brucite",))
    totals = chem.totals({**SALINE, "Mg": 1.0})
    solution = speciate(chem, totals, minerals=("brucite",))
    # PHREEQC with phreeqc.dat: 10.1045 and 0.2141. Measured 0.0198 and 0.7 %; with the activity
    # law of that file 0.0002 and 0.02 %.
    better = speciate(chem, totals, "wateq", minerals=("brucite",))
    assert better.ph[0] == pytest.approx(10.1045, abs=0.0005)
    assert better.totals[chem.components.index("Mg"), 0] == pytest.approx(0.2141, rel=5e-4)
    assert solution.ph[0] == pytest.approx(10.1045, abs=0.02)
    assert solution.totals[chem.components.index("Mg"), 0] == pytest.approx(0.2141, rel=0.02)
    assert solution.saturation_index[0, 0] == pytest.approx(0.0, abs=1e-10)
    undersaturated = speciate(chem, chem.totals({**SALINE, "Mg": 0.2}), minerals=("brucite",))
    assert undersaturated.mineral[0, 0] == 0.0
    assert undersaturated.saturation_index[0, 0] < 0.0


def test_a_vessel_open_to_carbon_dioxide_keeps_its_pressure() -> None:
    chem = chemistry("sbf")
    henry = 10**-1.5966
    for pressure, ph in ((0.05, 7.5845), (10**-3.5, 9.37)):
        solution = speciate(chem, chem.totals(SBF), gas={"CO2": henry * pressure})
        k = chem.index("CO2")
        activity = solution.concentration[k, 0] * 1e-3 * math.exp(solution.ln_gamma[k, 0])
        assert activity == pytest.approx(henry * pressure, rel=1e-10)
        assert solution.ph[0] == pytest.approx(ph, abs=0.02)  # PHREEQC, phreeqc.dat
        assert abs(solution.net_charge[0]) < 1e-12 * solution.strength[0] * 1e3


def test_several_minerals_are_complementary() -> None:
    names = ("brucite", "magnesite", "nesquehonite", "calcite", "hydroxyapatite")
    chem = chemistry("sbf", 37.0, names)
    totals = chem.totals({**SBF, "Mg": 20.0})
    solution = speciate(chem, totals, minerals=names)
    formed, index = solution.mineral[:, 0], solution.saturation_index[:, 0]
    assert (formed > 0).sum() >= 2
    assert (formed >= 0).all() and (index <= 1e-9).all()
    assert (np.abs(formed * index) < 1e-9).all()
    nu = np.array([m.stoichiometry for m in chem.minerals])
    # Elements and charge: round-off of sums of 142 mol/m3.
    assert solution.totals[:, 0] + nu.T @ formed == pytest.approx(totals, abs=1e-11)
    assert abs(solution.net_charge[0]) < 1e-12 * 147


def test_pure_water_and_the_ends_of_the_ph_scale() -> None:
    chem = chemistry("nacl", 25.0)
    assert speciate(chem, chem.totals({})).ph[0] == pytest.approx(6.9974, abs=1e-4)
    acid = speciate(chem, chem.totals({"Cl": 1000.0}), "ideal")
    alkali = speciate(chem, chem.totals({"Na": 1000.0}), "ideal")
    assert acid.ph[0] == pytest.approx(0.0, abs=1e-9)
    assert alkali.ph[0] == pytest.approx(13.9948, abs=1e-9)


def test_many_random_vessels_are_positive_neutral_and_conservative() -> None:
    chem = chemistry("sbf")
    rng = np.random.default_rng(12)
    n = 2000
    amounts = {
        name: 10.0 ** rng.uniform(-9, 3, n) * (rng.random(n) > 0.2)
        for name in ("Na", "Cl", "Mg", "Ca", "HCO3", "HPO4", "CO2")
    }
    rows = [
        amounts.get(name, np.zeros(n))[:, None] * chem.stoichiometry[k]
        for k, name in enumerate(chem.names)
    ]
    totals = chem.neutral(sum(rows).T)
    solution = speciate(chem, totals, "ideal")
    concentration = solution.concentration
    assert np.isfinite(concentration).all() and (concentration >= 0).all()
    size = np.abs(chem.stoichiometry).T @ concentration
    # Measured 3e-15: a last Newton step of 1e-11 leaves its square.
    assert (np.abs(solution.totals - totals) <= 1e-13 * np.maximum(size, 1e-30)).all()
    strength = 0.5 * chem.charge**2 @ concentration
    assert (np.abs(solution.net_charge) <= 1e-12 * strength).all()
    absent = totals[chem.components.index("Ca")] == 0
    assert absent.any()
    assert (solution.amount("CaHCO3")[absent] == 0).all()


def test_fixed_activity_equals_davies_at_the_medium() -> None:
    chem = chemistry("sbf")
    medium = speciate(chem, chem.totals(SBF))
    fixed = speciate(chem, chem.totals(SBF), "fixed", strength=medium.strength)
    assert fixed.ph == pytest.approx(medium.ph, abs=1e-11)


def test_the_law_of_wateq_by_hand() -> None:
    chem = chemistry("sbf")
    a, b = debye_hueckel(310.15)
    ln_gamma = wateq(chem, 0.16, a, b)
    for name, z, size, slope in (
        ("Ca", 2, 5.0, 0.165),
        ("PO4", 3, 4.0, 0.0),
        ("Cl", 1, 3.63, 0.017),
    ):
        law = -a * z**2 * 0.4 / (1 + b * size * 1e-10 * 0.4) + slope * 0.16
        assert ln_gamma[chem.index(name)] == pytest.approx(math.log(10) * law, rel=1e-12)
    # No size is given for NaCO3: Davies' equation, as in PHREEQC.
    pair = chem.index("NaCO3")
    assert ln_gamma[pair] == davies(chem.charge, 0.16, a)[pair]
    assert ln_gamma[chem.index("CO2")] == pytest.approx(math.log(10) * 0.016)


def test_davies_equation_by_hand() -> None:
    # -0.51 * 4 * (0.5/1.5 - 0.075) = -0.527; neutral 0.025
    value = davies(np.array([2.0, 0.0]), 0.25, 0.51) / math.log(10)
    assert value == pytest.approx([-0.527, 0.025], abs=1e-15)
    assert debye_hueckel(310.15) == (0.521144, 0.3304488e10)


@pytest.mark.parametrize(
    ("call", "error", "says"),
    [
        (lambda c: speciate(c, c.totals(SBF), "sit"), ValueError, "activity: 'sit'; allowed are"),
        (lambda c: speciate(c, c.totals(SBF), "fixed"), ValueError, "needs the ionic strength"),
        (lambda c: speciate(c, c.totals(SBF), minerals=("halite",)), ValueError, "'halite'"),
        (lambda c: c.totals({"K": 1.0}), ValueError, "species 'K' is unknown; known are H, CO3"),
        (lambda c: c.totals({"Na": -1.0}), ValueError, "total of Na: -1.0 mol/m3"),
        (lambda c: debye_hueckel(320.0), ValueError, "from 25 to 37 degC"),
        (lambda c: check_strength(1.5, "fixed"), ValueError, "use 'ideal'"),
        (
            lambda c: speciate(c, np.array([0, -1.0, 0, 0, 0, 0, 0]), "ideal"),
            CompositionError,
            "1 of 1 nodes have none; the lowest total of a component .* is -1",
        ),
    ],
)
def test_refusals(call, error, says: str) -> None:
    with pytest.raises(error, match=says):
        call(chemistry("sbf"))


def test_a_strong_medium_is_warned_about() -> None:
    assert "doubtful" in check_strength(0.7, "davies")
    assert check_strength(0.7, "ideal") == check_strength(0.15, "fixed") == ""
