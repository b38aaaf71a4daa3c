"""Mirror nodes behind electrodes: closed forms, Lambert's W, plain Python, and the bond form."""

import numpy as np
import pytest
from scipy.optimize import brentq

from peri.corrosion.polarization.tafel import TafelCurve
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice, ball
from peri.transport.potential.electrostatics import Electrode, PotentialProblem
from peri.transport.potential.mirror import MirrorPotential, lambert_value
from peri.transport.potential.polarization import LinearPolarization, surface_potential

KAPPA = 2.5
ANODE, CATHODE = TafelCurve(58.107, 0.4, -1.41), TafelCurve(0.00125, -0.153, -0.58)


def slab(thickness, cells, m, left, right):
    h, behind = thickness / cells, m + 1
    lattice = Lattice((0.0,), (h,), (cells + 2 * behind,))
    x = np.arange(lattice.shape[0]) - behind
    electrodes = [Electrode(x < 0, left), Electrode(x >= cells, right)]
    stencil = diffusion_stencil(lattice, m * h)
    return MirrorPotential(lattice, stencil, (x >= 0) & (x < cells), electrodes, KAPPA)


@pytest.mark.parametrize("m", [1, 2, 4, 8])
def test_slabs_are_exact(m):
    plates = LinearPolarization(0.1, 1e-2), LinearPolarization(0.6, 1e-2)
    found = slab(0.1, 40, m, *plates).solve()
    # measured 1e-14
    np.testing.assert_allclose(found.currents, [0.5 / 0.06, -0.5 / 0.06], rtol=1e-10)
    found = slab(0.01, 40, m, ANODE, CATHODE).solve()
    # 44.7105 A/m2 by the scalar equation
    exact = brentq(
        lambda i: (
            -0.58 - 0.153 * np.log10(i / 0.00125)
            + 1.41 - 0.4 * np.log10(i / 58.107) - i * 0.01 / KAPPA
        ),
        1.0, 100.0, xtol=1e-13,
    )  # fmt: skip
    assert exact == pytest.approx(44.7105, abs=1e-4)
    np.testing.assert_allclose(found.currents, [exact, -exact], rtol=1e-9)
    np.testing.assert_allclose(found.by_law, [exact, -exact], rtol=1e-9)
    assert abs(found.imbalance) < 1e-9 and found.newton <= 10


@pytest.mark.parametrize("law", [ANODE, CATHODE])
def test_lambert_form_is_the_root(law):
    """Eqs A4, A5 corrected against the root that any law gets, over 60 decades of w_0."""
    seen, distance = np.meshgrid(np.linspace(-3.0, 2.0, 41), np.geomspace(1e-6, 1e-2, 9))
    seen, distance = seen.ravel(), distance.ravel()
    surface = surface_potential(law, seen, 0.5 * distance / KAPPA)[0]
    sign = 1.0 if law is ANODE else -1.0
    assert np.sign(law.current(np.array(-1.0))) == sign
    closed = lambert_value(
        seen, distance, law.current_density, law.tafel_slope, law.standard_potential, KAPPA
    )
    # measured below 1e-14 V
    np.testing.assert_allclose(2.0 * surface - seen, closed, atol=1e-12)


def test_a_ring_against_plain_python():
    """2D, a disc in a ring: the same equations one bond at a time."""
    n, h, m = 13, 1e-3, 2
    lattice = Lattice((-6e-3, -6e-3), (h, h), (n, n))
    disc = ball(lattice, (0.0, 0.0), 1.6e-3)
    ring = ~ball(lattice, (0.0, 0.0), 5.2e-3)
    liquid = ~disc & ~ring
    stencil = diffusion_stencil(lattice, m * h)
    electrodes = [Electrode(disc, ANODE), Electrode(ring, CATHODE)]
    found = MirrorPotential(lattice, stencil, liquid, electrodes, KAPPA).solve()

    weights, law_of = stencil.dense(), np.where(disc, 0, 1)
    offsets = [(a, b) for a in range(-m, m + 1) for b in range(-m, m + 1) if weights[a + m, b + m]]
    wet = [tuple(p) for p in np.argwhere(liquid)]
    index = {p: k for k, p in enumerate(wet)}
    place = np.array(wet, float)

    def images(metal):
        normal = np.zeros(2)
        for a, b in offsets:
            if (metal[0] + a, metal[1] + b) in index:
                normal += (a, b)
        normal /= max(np.linalg.norm(normal), 1e-300)
        reach = np.sqrt(((place - metal) ** 2).sum(axis=1).min()) - 0.5
        mirrored = np.array(metal) + 2 * reach * normal
        away = np.sqrt(((place - mirrored) ** 2).sum(axis=1))
        return int(np.flatnonzero(away < away.min() + 1e-7)[0]), 2 * reach * h

    known = {}

    def residual(u):
        out = np.zeros(len(wet))
        for k, p in enumerate(wet):
            for a, b in offsets:
                q, w = (p[0] + a, p[1] + b), weights[a + m, b + m]
                if not (0 <= q[0] < n and 0 <= q[1] < n):
                    continue
                if q in index:
                    out[k] += w * (u[k] - u[index[q]])
                else:
                    if q not in known:
                        known[q] = images(q)
                    at, d = known[q]
                    law = (ANODE, CATHODE)[law_of[q]]
                    seen = u[at]
                    mirror = brentq(
                        lambda v, s=seen, d=d, law=law: (
                            v - s + d / KAPPA * float(law.current(np.array(0.5 * (v + s))))
                        ),
                        seen - 3.0, seen + 3.0, xtol=1e-14,
                    )  # fmt: skip
                    out[k] += w * (u[k] - mirror)
        return out

    u = -found.potential[liquid]
    scale = stencil.total * np.abs(u).max()
    assert np.abs(residual(u)).max() < 1e-10 * scale  # round-off
    # the residual of another field is not small: 1e-3 V more somewhere
    off = u.copy()
    off[len(u) // 2] += 1e-3
    assert np.abs(residual(off)).max() > 1e-5 * scale


def test_beside_the_bond_form_currents_do_not_balance():
    """A disc in a ring, radius 1.9 and 3.8 horizons: by the law anodic is not cathodic."""
    radius, outer, m, apart = 2.5e-3, 7e-3, 2, []
    for cells in (24, 48):
        h = 2 * 8e-3 / cells
        lattice = Lattice((-8e-3 + 0.5 * h,) * 2, (h, h), (cells, cells))
        disc, ring = ball(lattice, (0, 0), radius), ~ball(lattice, (0, 0), outer)
        electrodes = [
            Electrode(disc, LinearPolarization(-1.0, 1e-3)),
            Electrode(ring, LinearPolarization(0.0, 1e-3)),
        ]
        stencil, liquid = diffusion_stencil(lattice, m * h), ~disc & ~ring
        bonds = PotentialProblem(lattice, stencil, liquid, electrodes, KAPPA).solve()
        mirror = MirrorPotential(lattice, stencil, liquid, electrodes, KAPPA).solve()
        resistance = 1e-3 / (2 * np.pi) * (1 / radius + 1 / outer)
        exact = 1.0 / (resistance + np.log(outer / radius) / (2 * np.pi * KAPPA))
        # measured 4.3 and -2.5 % (bonds), -4.5 and -2.8 % (mirror)
        assert bonds.current(0) == pytest.approx(exact, rel=0.05)
        np.testing.assert_allclose(mirror.currents, [exact, -exact], rtol=0.05)
        assert abs(mirror.currents.sum()) < 1e-9 * exact and abs(bonds.imbalance) < 1e-12
        apart.append(abs(mirror.imbalance))
    # measured 8.2 and 0.9 %
    assert apart[0] > apart[1] > 1e-3


def test_refusals():
    lattice = Lattice((0.0,), (1e-3,), (10,))
    stencil = diffusion_stencil(lattice, 2e-3)
    liquid = np.arange(10) < 5
    with pytest.raises(ValueError, match="none of them touches the liquid"):
        far = Electrode(np.arange(10) > 8, ANODE)
        MirrorPotential(lattice, stencil, liquid, [far], KAPPA)
    with pytest.raises(ValueError, match="conductivity: 0.0 S/m"):
        MirrorPotential(lattice, stencil, liquid, [Electrode(~liquid, ANODE)], 0.0)
