"""Several materials in one solid: exact solutions, patches, checkpoints, refusals."""

import numpy as np
import pytest
from scipy.optimize import brentq

pytest.importorskip("dolfinx")

from fem.constitutive import Material, VoceHardening
from fem.constitutive.hardening import TabulatedHardening
from fem.patches import make_patches, sound_patches
from fem.results import Checkpoint
from fem.strength import TensileSettings, tensile_test
from tests.fem.meshes import box, round_bar

MAGNESIUM = Material(43e9, 0.3, VoceHardening(130e6, 156e6, 10.6))
STEEL = Material(207e9, 0.29, TabulatedHardening((0.0, 0.02, 0.1), (300e6, 350e6, 420e6)), q1=1.25)
BAR = round_bar(2, 4, 1e-3, 4e-3, waist=0.3)
ELEMENTS = ["P1", "P1-Fbar", "P2", "P2-Fbar"]


def elastic(young: float) -> Material:
    """Hencky's law without lateral strain, far from yield."""
    return Material(young, 0.0, VoceHardening(10.0 * young))


def layers(cells, points, height=1e-3):
    """0 below a height, 1 above."""
    return (points[cells, 2].mean(axis=1) > height).astype(int)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize(("below", "above"), [(1e9, 3e9), (1e9, 1e15), (1e15, 1e9)])
def test_two_layers_share_the_force_and_add_their_elongations(element, below, above):
    """E ln(stretch) / stretch is the same in both, at moduli up to 1e6 apart."""
    points, cells = box((1, 1, 4), (1e-3, 1e-3, 2e-3))
    # 1e-16 of the stretch of a stiff cell is 1e-8 of the reaction where it is 1e6 times as stiff
    settings = TensileSettings(
        element, maximum_strain=0.05, full_curve=True, first_increment=0.01,
        maximum_increment=0.01, tolerance=1e-9 if max(below, above) < 1e10 else 1e-7,
    )  # fmt: skip
    moduli = (below, above)
    result = tensile_test(
        points, cells, 0.0, [elastic(young) for young in moduli], settings,
        material_of_cell=layers(cells, points),
    )  # fmt: skip
    assert result.status == "completed"

    def other(stretch):  # of the second layer, 0.05 * 2 mm over 1 mm in all
        return 2.1 - stretch

    def gap(stretch):
        first = below * np.log(stretch) / stretch
        return first - above * np.log(other(stretch)) / other(stretch)

    stretch = brentq(gap, 1.0, 1.1, xtol=1e-16)
    softer = stretch if below < above else other(stretch)
    force = min(moduli) * np.log(softer) / softer * 1e-6
    # measured 6e-15, and 2e-9 where the grip pulls the stiff layer: round-off, as above
    assert result.force[-1] == pytest.approx(force, rel=1e-8)
    middle = abs(points[:, 2] - 1e-3) < 1e-9
    moved = result.displacement[middle, 2]
    # measured 6e-19 m of 1e-4 m, or of 5e-11 m
    np.testing.assert_allclose(moved, (stretch - 1.0) * 1e-3, rtol=1e-6, atol=1e-17)


@pytest.mark.parametrize("element", ["P1-Fbar", "P2"])
def test_bars_of_two_materials_side_by_side_carry_what_each_does(element):
    """Porous and plastic, with hardening laws of two kinds and two values of q1."""
    points, cells = BAR
    settings = TensileSettings(
        element, maximum_strain=0.02, full_curve=True, first_increment=0.002,
        maximum_increment=0.002, tolerance=1e-8,
    )  # fmt: skip
    f0 = np.where(layers(cells, points, 2e-3) > 0, 0.1, 0.0)
    alone = [tensile_test(points, cells, f0, m, settings) for m in (MAGNESIUM, STEEL)]
    assert alone[1].force[-1] > 2 * alone[0].force[-1] > 100
    both = tensile_test(
        np.concatenate([points, points + [3e-3, 0, 0]]),
        np.concatenate([cells, cells + len(points)]),
        np.tile(f0, 2), [MAGNESIUM, STEEL], settings,
        material_of_cell=np.repeat([0, 1], len(cells)),
    )  # fmt: skip
    np.testing.assert_array_equal(both.elongation, alone[0].elongation)
    for name in ("force", "stored", "dissipated"):
        total = alone[0].history[name] + alone[1].history[name]
        # tolerance 1e-8 of the reaction: measured 2e-10
        np.testing.assert_allclose(both.history[name][1:], total[1:], rtol=1e-8)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_one_material_given_twice_is_one_material(element):
    settings = TensileSettings(element, maximum_strain=0.01, full_curve=True)
    one = tensile_test(*BAR, 0.1, MAGNESIUM, settings)
    rows = np.arange(len(BAR[1])) % 2
    two = tensile_test(*BAR, 0.1, [MAGNESIUM] * 2, settings, material_of_cell=rows)
    np.testing.assert_array_equal(two.force, one.force)


def test_patches_do_not_mix_materials():
    points, cells = box((3, 3, 6), (1e-3, 1e-3, 2e-3))
    rows = layers(cells, points)
    sound = np.arange(len(cells)) % 5 > 0
    groups = sound_patches(cells, len(points), sound, rows)
    sizes = np.bincount(groups)
    assert sizes.max() > 3 and np.all(sizes[groups[~sound]] == 1)
    for row in (0, 1):
        assert not np.isin(groups[rows == row], groups[rows != row]).any()
    everywhere = sound_patches(cells, len(points), np.ones(len(cells), bool), 0 * rows)
    np.testing.assert_array_equal(everywhere, make_patches(cells, len(points)))


def test_a_test_of_two_materials_is_resumed_and_another_division_refused(tmp_path):
    points, cells = BAR
    rows = layers(cells, points, 2e-3)
    settings = TensileSettings(
        "P1-Fbar", maximum_strain=0.02, full_curve=True, tolerance=1e-8, first_increment=0.004,
        maximum_increment=0.004,
    )  # fmt: skip
    pair, path = [MAGNESIUM, STEEL], tmp_path / "test.h5"

    def run(of_cell, observers=(), resume=None):
        return tensile_test(
            points, cells, 0.1, pair, settings, observers=observers, resume=resume,
            material_of_cell=of_cell,
        )  # fmt: skip

    whole = run(rows, [Checkpoint(path, every=2)])
    resumed = run(rows, resume=path)
    assert len(resumed.force) == len(whole.force) == 6
    # from the fourth of five increments, by another prediction: measured 2e-11
    np.testing.assert_allclose(resumed.force, whole.force, rtol=1e-8)
    with pytest.raises(ValueError, match="belongs to another mesh, damage, material"):
        run(1 - rows, resume=path)


@pytest.mark.parametrize(
    ("materials", "rows", "words"),
    [
        ([MAGNESIUM, STEEL], None, "2 materials are given"),
        ([], None, "0 materials are given"),
        ([MAGNESIUM, STEEL], np.zeros(3, int), r"shape \(3,\)"),
        ([MAGNESIUM, STEEL], np.zeros(96), "float64"),
        ([MAGNESIUM, STEEL], np.full(96, 2), "from 2 to 2; it must lie in 0 to 1"),
        (MAGNESIUM, np.full(96, -1), "from -1 to -1"),
    ],
)
def test_cells_without_a_material_are_refused(materials, rows, words):
    with pytest.raises(ValueError, match=words):
        tensile_test(*BAR, 0.0, materials, material_of_cell=rows)


def test_the_largest_damage_is_that_of_the_cells_own_material():
    rows = layers(BAR[1], BAR[0], 2e-3)
    f0 = np.where(rows > 0, 0.75, 0.6)  # 1/q1 = 0.8 for the steel, 2/3 for the magnesium
    pair = [MAGNESIUM, STEEL]
    assert tensile_test(*BAR, f0, pair, material_of_cell=rows).peak_force > 1.0
    with pytest.raises(ValueError, match=r"it must lie in \[0, 1/q1 = 0.666667\]"):
        tensile_test(*BAR, f0, pair, material_of_cell=1 - rows)
