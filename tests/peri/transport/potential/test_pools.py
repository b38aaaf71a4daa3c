"""Pools of liquid that a metal node of one layer separates: each balances by itself."""

import numpy as np
import pytest

from peri.corrosion.polarization import TabulatedCurve, TafelCurve
from peri.coupled.galvanic import GalvanicScene, Metal, Renewal, corrode, potential
from peri.engine.lattice import Lattice
from peri.transport.potential.electrostatics import NoSinkError
from peri.transport.potential.polarization import LinearPolarization


def bar(nodes: int, metals, ratio: int = 2, spacing: float = 1e-3) -> GalvanicScene:
    """Metals by their nodes and laws in a line of liquid; the first dissolves."""
    lattice = Lattice((0.0,), (spacing,), (nodes,))
    made = []
    for n, (place, law) in enumerate(metals):
        mask = np.zeros(nodes, bool)
        mask[place] = True
        made.append(Metal(f"m{n}", mask, law, *((1e5, 2.0) if n == 0 else ())))
    return GalvanicScene(lattice, ratio * spacing, tuple(made), 1.0)


# Nodes of the layer, and of the horizon: bonds would cross a layer that is thinner than that.
LAYERS = [(4, 2), (1, 1)]


@pytest.mark.parametrize(("thick", "ratio"), LAYERS)
def test_a_dead_end_behind_a_metal_layer_carries_nothing(thick, ratio):
    """The same current with a bath behind the cathode, which it cannot leave, as without."""
    anode, cathode = LinearPolarization(-1.0, 1e-3), LinearPolarization(0.0, 1e-2)
    there = slice(20, 20 + thick)
    found = potential(bar(40, [(slice(0, 5), anode), (there, cathode)], ratio))
    # 1 V over 15 mm of liquid (1 S/m) and both resistances
    assert found.current(0) == pytest.approx(1.0 / (15e-3 + 1e-3 + 1e-2), rel=1e-9)
    behind = found.patches.shares[:, ratio + 20 + thick :].sum(axis=1).A1 > 0
    assert behind.sum() == 1
    assert np.abs(found.density[behind]).max() < 1e-12 * np.abs(found.density).max()


@pytest.mark.parametrize(("thick", "ratio"), LAYERS)
def test_a_layer_between_two_baths_feeds_both(thick, ratio):
    """A cathode between two anodes: each side has its own current, which balances by itself."""
    cathode = LinearPolarization(0.0, 1e-2)
    anodes = LinearPolarization(-1.0, 1e-3), LinearPolarization(-0.5, 1e-3)
    there, far = slice(19, 19 + thick), slice(19 + thick + 14, 19 + thick + 20)
    scene = bar(far.stop, [(slice(0, 5), anodes[0]), (far, anodes[1]), (there, cathode)], ratio)
    found = potential(scene)
    left, right = 1.0 / (14e-3 + 1.1e-2), 0.5 / (14e-3 + 1.1e-2)
    assert found.current(0) == pytest.approx(left, rel=1e-9)
    assert found.current(1) == pytest.approx(right, rel=1e-9)
    assert abs(found.imbalance) < 1e-12


def test_tafel_laws_that_never_vanish_beside_dead_ends():
    """An anode and a cathode of one node each, liquid beyond both, which no current may enter."""
    laws = TafelCurve(1e-3, 0.05, 1.0), TafelCurve(0.1, -0.1, 0.4)
    scene = bar(41, [(slice(10, 12), laws[0]), (slice(28, 30), laws[1])])
    found = potential(scene)
    assert found.current(0) > 0 and abs(found.imbalance) < 1e-12
    done = corrode(scene, [1e9], Renewal(1.0))
    assert np.abs(done.history["faraday_error"]).max() < 1e-12


def test_what_is_left_of_a_couple_goes_on_by_itself():
    """An anode between two cathodes that only sink: without it no current is left, and no error."""
    scene = bar(30, [(slice(14, 16), TafelCurve(1.0, 0.1, 0.0)),
                     (slice(0, 3), TafelCurve(1.0, -0.1, 1.0))])  # fmt: skip
    with pytest.raises(NoSinkError, match="one sign at every potential"):
        potential(bar(30, [(slice(14, 16), TafelCurve(1.0, 0.1, 0.0))]))
    done = corrode(scene, [1e12], Renewal(1.0))
    assert not done.fields["concentration"][-1].any()
    assert done.history["current_m0"][-1] == 0.0


def test_a_measured_curve_is_not_used_beyond_its_points():
    curve = TabulatedCurve((-1.2, -1.1, -1.0), (0.0, 1.0, 5.0))
    inside = bar(30, [(slice(0, 4), curve), (slice(20, 24), LinearPolarization(-0.9, 0.1))])
    assert potential(inside).current(0) > 0
    outside = bar(30, [(slice(0, 4), curve), (slice(20, 24), LinearPolarization(3.0, 0.01))])
    with pytest.raises(ValueError, match="outside the polarization curve.* from -1.2 to -1.0 V"):
        potential(outside)
