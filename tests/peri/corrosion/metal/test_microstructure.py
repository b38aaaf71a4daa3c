"""Voronoi polycrystals with boundaries and particles."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import label

from peri.corrosion.metal import microstructure as module
from peri.corrosion.metal.microstructure import (
    BOUNDARY,
    GRAIN,
    PARTICLE,
    polycrystal,
    with_particles,
)
from peri.engine.lattice import Lattice

SQUARE = Lattice((-40e-6, 10e-6), (0.5e-6, 0.5e-6), (160, 120))


def test_boundaries_of_known_width_and_grains_in_one_piece():
    size, width = 12e-6, 1.5e-6
    found = polycrystal(SQUARE, size, width, seed=3)
    area = SQUARE.cell_volume * found.phase.size
    grains = len(found.draw)
    # As many as cells of the grid meet the lattice, give or take one around the edge.
    assert area / size**2 < grains < 1.8 * area / size**2
    assert set(np.unique(found.grain)) == set(range(grains))
    for number in range(grains):
        assert label(found.grain == number)[1] == 1  # convex
    # Faces by a plain count: the length of all faces times their width is the boundary's area but
    # for the triple points, where strips overlap.
    bare = found.grain
    across = (bare[1:] != bare[:-1]).sum() * 0.5e-6 + (bare[:, 1:] != bare[:, :-1]).sum() * 0.5e-6
    length = across * np.pi / 4  # staircase of evenly distributed directions
    share = (found.phase == BOUNDARY).mean()
    assert share == pytest.approx(length * width / area, rel=0.12)
    assert share > 0.1
    none = polycrystal(SQUARE, size, seed=3)
    assert (none.phase == GRAIN).all() and (none.grain == found.grain).all()


@pytest.mark.parametrize("shape", [(40,), (36, 30), (14, 15, 16)])
def test_against_all_points(shape):
    """Nearest point and distance to every bisecting plane by brute force, elongated grains."""
    d = len(shape)
    lattice = Lattice((3e-6,) * d, (1e-6,) * d, shape)
    size = np.array([8e-6, 5e-6, 4e-6][:d])
    width = 2e-6
    found = polycrystal(lattice, size, width, seed=11)
    _, points = module._points(lattice, size, 11, 0, margin=4)
    place = module._places(lattice)
    far = (((place / size)[:, None] - points[None]) ** 2).sum(axis=2)
    nearest = far.argmin(axis=1)
    # Same partition: one number of theirs for each of ours.
    pairs = np.unique(np.stack([nearest, found.grain.ravel()]), axis=1)
    assert pairs.shape[1] == np.unique(nearest).size == len(found.draw)
    away = np.full(len(place), np.inf)
    own = points[nearest] * size
    for k, other in enumerate(points * size):
        normal = (other - own) / size**2
        length = np.linalg.norm(normal, axis=1)
        ahead = (normal * (0.5 * (own + other) - place)).sum(axis=1)
        plane = np.divide(ahead, length, out=np.full(len(place), np.inf), where=length > 0)
        away = np.where(k == nearest, away, np.minimum(away, plane))
    expected = away <= 0.5 * width
    clear = np.abs(away - 0.5 * width) > 1e-12
    np.testing.assert_array_equal((found.phase.ravel() == BOUNDARY)[clear], expected[clear])
    assert 0.1 < expected.mean() < 0.95


def test_elongated_grains_are_elongated():
    lattice = Lattice((0.0, 0.0), (1e-6, 1e-6), (240, 240))
    grain = polycrystal(lattice, (40e-6, 10e-6), seed=5).grain
    crossed = [(np.diff(grain, axis=a) != 0).sum() for a in (0, 1)]
    # Faces met per length along each axis go like 1 over the size: 4, 4.0 to 4.3 for ten seeds.
    assert crossed[1] / crossed[0] == pytest.approx(4.0, rel=0.15)


def test_part_and_finer_lattice_see_the_same_structure():
    whole = polycrystal(SQUARE, 12e-6, 1.5e-6, seed=3)
    whole = with_particles(SQUARE, whole, 1.5e-6, 0.1, seed=8)
    part = replace(SQUARE, origin=(-40e-6 + 30 * 0.5e-6, 10e-6), shape=(130, 50))
    box = polycrystal(part, 12e-6, 1.5e-6, seed=3)
    box = with_particles(part, box, 1.5e-6, 0.1, seed=8)
    np.testing.assert_array_equal(box.phase, whole.phase[30:, :50])
    one, other = whole.values(1.0, 2.0, 3.0, (0.5, 2.0)), box.values(1.0, 2.0, 3.0, (0.5, 2.0))
    np.testing.assert_array_equal(other, one[30:, :50])
    again = polycrystal(SQUARE, 12e-6, 1.5e-6, seed=4)
    assert (again.phase != whole.phase).mean() > 0.1


@pytest.mark.parametrize(("shape", "fraction"), [((300, 200), 0.2), ((60, 50, 70), 0.12)])
def test_particles_fill_their_share_and_never_touch(shape, fraction):
    d = len(shape)
    lattice = Lattice((0.0,) * d, (1e-6,) * d, shape)
    structure = polycrystal(lattice, 30e-6, seed=1)
    radius = 4e-6
    found = with_particles(lattice, structure, radius, fraction, seed=2)
    share = (found.phase == PARTICLE).mean()
    # A few hundred particles whole, those at the edges cut: scatter of the share about 2 %.
    assert share == pytest.approx(fraction, rel=0.05)
    biggest = np.bincount(label(found.phase == PARTICLE)[0].ravel())[1:].max()
    volume = {2: np.pi * 16, 3: 4 / 3 * np.pi * 64}[d]
    assert biggest < 2.2 * volume  # two may come within a node of each other


def test_values_by_phase_and_orientation():
    structure = polycrystal(SQUARE, 12e-6, 1.5e-6, seed=3)
    rate = structure.values(1.0, boundary=50.0, orientation=(0.5, 1.5))
    assert (rate[structure.phase == BOUNDARY] == 50.0).all()
    inside = structure.phase == GRAIN
    assert 0.5 <= rate[inside].min() < 0.7 and 1.3 < rate[inside].max() <= 1.5
    for number in range(5):
        assert np.unique(rate[inside & (structure.grain == number)]).size <= 1


def test_refusals():
    structure = polycrystal(SQUARE, 12e-6, 1.5e-6)
    for call, message in (
        (lambda: polycrystal(SQUARE, 0.9e-6), "grain_size: .* at least two spacings"),
        (
            lambda: polycrystal(SQUARE, 12e-6, 0.9e-6),
            "boundary_width: 9e-07 m; it must be 0, or at",
        ),
        (lambda: polycrystal(SQUARE, 12e-6, 12e-6), "boundary_width: 1.2e-05 m"),
        (lambda: polycrystal(SQUARE, 12e-6, seed=-1), "seed: -1"),
        (
            lambda: polycrystal(replace(SQUARE, origin=(9.0, 0.0)), 12e-6),
            "farther than 2.18 grains",
        ),
        (lambda: structure.values(1.0), "boundary: missing, but"),
        (lambda: structure.values(1.0, 0.0), "boundary: 0.0; it must be finite and positive"),
        (lambda: structure.values(1.0, 1.0, orientation=(0.0, 1.0)), "orientation: .*positive"),
        (lambda: with_particles(SQUARE, structure, 0.1e-6, 0.1), "radius: .* at least the spacing"),
        (lambda: with_particles(SQUARE, structure, 2e-6, 0.5), "fraction: 0.5; .* at most 0.393"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
