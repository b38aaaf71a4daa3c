"""The crevice on a lattice of 25:1 beside the film equation on the same staircase."""

import numpy as np
import pytest

from pipeline.benches.localised import iterations
from pipeline.scenes.crevice_lattice import HOUR, compare, crevice_on_lattice, film_of


def test_lattice_and_film_agree_while_no_node_is_empty():
    """A crevice of 6 mm, 2 h: active site within 2 %, area lost within 1 %.

    What is gone of a cell is liquid at once, as in the film, though the cell is metal.
    """
    scene = crevice_on_lattice(3e-3, length=6e-3)
    found = compare(scene, [1.5 * HOUR, 2 * HOUR])
    history = found.result.history
    assert np.abs(history["balance_error"]).max() < 1e-12
    assert found.result.concentration[-1][~found.result.metal[-1]].max() <= 5600.0 * (1 + 1e-9)
    lattice, film = (found.lost(depth)[-1] for depth in (found.lattice, found.film))
    assert lattice == pytest.approx(film, rel=0.01)  # measured +0.06 %
    assert found.site(found.lattice) == pytest.approx(found.site(found.film), rel=0.02)
    assert found.lattice[-1].max() == pytest.approx(found.film[-1].max(), rel=0.05)
    assert (np.diff(found.lattice, axis=0) >= -1e-15).all()


def test_few_iterations_on_stretched_cells():
    assert iterations(crevice_on_lattice(3e-3)) <= 20  # 19 measured


def test_what_the_film_of_a_lattice_is():
    scene = crevice_on_lattice(3e-3)
    film = film_of(scene)
    taper = 25e-6 - 20e-6 * film.places / film.length
    assert np.abs(film.gap - taper).max() <= 0.5e-6 * (1 + 1e-9)
    assert film.length == pytest.approx(12.7e-3)
    seeded = film.concentration > 0
    assert film.places[seeded].min() == pytest.approx(film.length - 3e-3, abs=25e-6)


@pytest.mark.slow
def test_lattice_and_film_agree_as_nodes_empty():
    """After 12 h, the first layers gone: area lost within 1 %; without pores 6.7 % less."""
    lost = {}
    for pores in (True, False):
        scene = crevice_on_lattice(3e-3, length=6e-3, pores=pores)
        found = compare(scene, [6 * HOUR, 12 * HOUR])
        assert (scene.metal & ~found.result.metal[-1]).sum() > 30
        assert np.abs(found.result.history["balance_error"]).max() < 1e-12
        lost[pores] = found.lost(found.lattice)[-1] / found.lost(found.film)[-1] - 1
        if pores:
            assert found.site(found.lattice) == pytest.approx(found.site(found.film), rel=0.02)
    assert abs(lost[True]) < 0.01  # measured -1.0 % (-0.2 % for 0.5 um across)
    assert lost[False] < -0.05


@pytest.mark.slow
def test_without_conduction_along_walls_the_film_is_too_thin():
    """Rows beside the walls lack bonds: a seventh less dissolves."""
    lost = []
    for walls in (True, False):
        scene = crevice_on_lattice(3e-3, length=6e-3, walls=walls, pores=False)
        found = compare(scene, [1.5 * HOUR, 2 * HOUR])
        lost.append(found.lost(found.lattice)[-1])
    assert lost[1] < 0.9 * lost[0]  # measured 0.313 and 0.370 um mm
