"""What a couple leaves out, with its bound beside the full computation."""

from dataclasses import replace

import numpy as np
import pytest

from peri.corrosion.polarization import ButlerVolmerCurve, TafelCurve
from peri.coupled.galvanic import GalvanicScene, Metal, Renewal, corrode, potential
from peri.coupled.wagner import corrode_lean, couple_omissions
from peri.engine.lattice import Lattice
from peri.transport.potential.polarization import LinearPolarization

H = 1e-3


def couple(conductivity: float, anode, cathode, across: bool = True) -> GalvanicScene:
    """Two plates side by side below liquid, or facing each other; the first dissolves."""
    shape = (12, 8) if across else (30,)
    lattice = Lattice((0.5 * H,) * len(shape), (H,) * len(shape), shape)
    place = np.broadcast_to(lattice.coordinates()[-1], shape)
    solid = place < 3 * H
    if across:
        x = np.broadcast_to(lattice.coordinates()[0], shape)
        nodes = solid & (x < 6 * H), solid & (x > 6 * H)
    else:
        nodes = solid, place > 25 * H
    metals = Metal("anode", nodes[0], anode, 7e4, 2.0), Metal("cathode", nodes[1], cathode)
    return GalvanicScene(lattice, 2 * H, metals, conductivity)


def by_name(omissions):
    return {o.name: o for o in omissions}


LAWS = [
    (LinearPolarization(-1.0, 1.0), LinearPolarization(0.0, 3.0)),
    (TafelCurve(0.1, 0.1, -1.2), TafelCurve(0.1, -0.15, -0.8)),
    (ButlerVolmerCurve(0.01, -1.0), LinearPolarization(0.0, 10.0)),
]


@pytest.mark.parametrize("laws", LAWS)
@pytest.mark.parametrize("conductivity", [0.5, 10.0, 1e3])
def test_one_potential_is_within_its_bound(laws, conductivity):
    scene = couple(conductivity, *laws)
    omission = by_name(couple_omissions(scene))["potential"]
    full = potential(scene).current(0)
    even = corrode(scene, [1.0], one_level=True).history["current_anode"][0]
    error = abs(even / full - 1)
    assert 0 < error < omission.bound
    # measured 2 to 40 times the true error (a range on both sides, and every patch at its worst)
    assert omission.bound < 100 * error or omission.bound > 1
    assert omission.applied == (omission.bound <= 1e-3)


@pytest.mark.parametrize("resistance", [1e-2, 1e-4, 1e-6])
def test_rest_potentials_are_within_their_bound(resistance):
    laws = LinearPolarization(-1.0, resistance), LinearPolarization(0.0, 2 * resistance)
    scene = couple(2.5, *laws)
    omission = by_name(couple_omissions(scene, tolerance=0.1))["kinetics"]
    full = potential(scene).current(0)
    fast, _ = corrode_lean(scene, [1e-3], tolerance=0.1)
    if omission.applied:
        error = abs(fast.history["current_anode"][0] / full - 1)
        assert 0 < error < omission.bound <= 0.1
    assert omission.applied == (omission.bound <= 0.1) == (resistance == 1e-6)
    refusing, _ = corrode_lean(scene, [1e-3], tolerance=0.1, refused=["kinetics", "renewal"])
    assert refusing.history["current_anode"][0] == pytest.approx(full, rel=1e-12)


def test_laws_without_rest_potential_need_their_kinetics():
    omission = by_name(couple_omissions(couple(2.5, *LAWS[1])))["kinetics"]
    assert not omission.applied and np.isinf(omission.bound)


def test_a_potential_that_is_kept_changes_little():
    """Charge after three nodes' travel with the potential renewed by need and at every step."""
    scene = couple(20.0, *LAWS[0])
    often = corrode(scene, [2e8], Renewal(0.05))
    kept, omissions = corrode_lean(
        scene, [2e8], Renewal(0.05), tolerance=2e-3, refused=["potential"]
    )
    assert by_name(omissions)["renewal"].applied
    solved = [np.count_nonzero(r.history["newton"]) for r in (often, kept)]
    assert solved[1] < 0.7 * solved[0], solved
    charge = [float(r.history["charge"][-1]) for r in (often, kept)]
    assert often.history["dissolved_nodes"].sum() > 5
    assert charge[1] == pytest.approx(charge[0], rel=2e-3)
    assert abs(kept.history["faraday_error"]).max() < 1e-12


def test_a_potential_that_is_needed_in_the_end_is_computed_after_all():
    """A gap of a spacing is even; once it has grown to ten the liquid resists."""
    lattice = Lattice((0.5 * H,), (H,), (20,))
    x = lattice.axis(0)
    metals = (
        Metal("anode", x < 12 * H, LinearPolarization(-1.0, 1.0), 7e4, 2.0),
        Metal("cathode", x > 13 * H, LinearPolarization(0.0, 3.0)),
    )
    scene = GalvanicScene(lattice, 2 * H, metals, 2.0)
    metal, flux = 7e4 * 10 * H, 0.25 / (2 * 96485.33)
    found, omissions = corrode_lean(scene, [metal / flux], Renewal(0.5))
    assert by_name(couple_omissions(scene))["potential"].bound < 1e-3
    said = by_name(omissions)["potential"]
    assert not said.applied and "off at the end" in said.reason
    # 1 V over both surfaces and ten spacings of liquid
    assert found.history["current_anode"][-1] == pytest.approx(1 / (4 + 11 * H / 2.0), rel=1e-3)
    half, kept = corrode_lean(scene, [0.1 * metal / flux], Renewal(0.5))
    assert by_name(kept)["potential"].applied
    assert half.history["current_anode"][-1] == pytest.approx(1 / (4 + 2 * H / 2.0), rel=1e-3)


def test_refusals():
    scene = couple(1.0, *LAWS[0])
    with pytest.raises(ValueError, match="known: potential, kinetics, ions, renewal"):
        couple_omissions(scene, refused=["transport"])
    with pytest.raises(ValueError, match="change: 1.0; it must be from 0"):
        Renewal(change=1.0)


def test_mirror_nodes_leave_nothing_out():
    scene = replace(couple(2.5, *LAWS[0]), robin="as_published")
    assert not any(o.applied for o in couple_omissions(scene, tolerance=0.5))
