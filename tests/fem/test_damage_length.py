"""The averaging of damage growth: conservation, a closed form, and what it does to a bar."""

import numpy as np
import pytest

from fem.constitutive import Material, VoceHardening
from fem.damage_length import DamageLength
from fem.strength import TensileSettings, tensile_test
from tests.fem.meshes import box

MAGNESIUM = Material(43e9, 0.3, VoceHardening(130e6, 156e6, 10.6))


def test_conserves_the_volume_and_leaves_sound_metal_alone():
    points, cells = box((4, 4, 8), (1e-3, 1e-3, 2e-3))
    average = DamageLength(points, cells, 3e-4)
    strain = np.random.default_rng(1).uniform(0.0, 0.1, len(cells))
    porous = points[cells, 2].mean(axis=1) < 1e-3
    mean = average.average(strain, porous)
    assert np.ptp(mean[porous]) < 0.7 * np.ptp(strain[porous])
    np.testing.assert_array_equal(mean[~porous], strain[~porous])
    volumes = average.volumes[porous]
    # the tolerance of the linear solver: measured 1e-9
    assert mean[porous] @ volumes == pytest.approx(strain[porous] @ volumes, rel=1e-7)


def test_a_wave_shrinks_as_the_helmholtz_equation_says():
    """cos(pi z / h) along a bar of length h shrinks by 1 / (1 + (pi length / h)^2)."""
    height, length = 2e-3, 4e-4
    errors = []
    for layers in (16, 32):
        points, cells = box((1, 1, layers), (2e-4, 2e-4, height))
        z = points[cells, 2].mean(axis=1)
        wave = np.cos(np.pi * z / height)
        mean = DamageLength(points, cells, length).average(wave, np.ones(len(cells), bool))
        expected = 1.0 / (1.0 + (np.pi * length / height) ** 2)
        errors.append(abs(mean @ wave / (wave @ wave) / expected - 1.0))
    # second order in the layers: measured 6.8e-3 and 1.7e-3
    assert errors[1] < 0.3 * errors[0] and errors[1] < 2e-3


def test_softening_of_a_bar_with_a_weak_layer():
    """The weaker layer tears later, and less abruptly, when f grows over a length."""
    points, cells = box((1, 1, 8), (0.5e-3, 0.5e-3, 2e-3))
    weak = abs(points[cells, 2].mean(axis=1) - 1e-3) < 0.26e-3
    settings = {"element": "P1", "maximum_strain": 0.08, "full_curve": True, "damage": "cell"}
    results = [
        tensile_test(
            points, cells, np.where(weak, 0.3, 0.25), MAGNESIUM,
            TensileSettings(**settings, damage_length=length),
        )
        for length in (0.0, 1e-3)
    ]  # fmt: skip
    damage = [result.history["largest_damage"][-1] for result in results]
    # measured 0.331 and 0.315; 26.9 and 27.2 N
    assert 0.3 < damage[1] < damage[0] - 0.01
    assert results[1].peak_force >= results[0].peak_force


def test_refuses_a_length_without_one_f_per_cell():
    with pytest.raises(ValueError, match="only allowed with 'cell'"):
        TensileSettings(damage="point", damage_length=1e-4)
    with pytest.raises(ValueError, match="damage_length is -1"):
        TensileSettings(damage="cell", damage_length=-1.0)
