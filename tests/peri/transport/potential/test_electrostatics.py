"""The potential between electrodes against closed forms, scalar equations and finite volumes."""

import gc
import weakref

import numpy as np
import pytest
from scipy.optimize import brentq

from peri.corrosion.polarization import PiecewiseTafelCurve
from peri.corrosion.polarization import TafelCurve as Tafel
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice
from peri.engine.operators import NonlocalSum
from peri.engine.walls import Walls
from peri.schemes.bonds import Harmonic
from peri.transport.potential.electrostatics import Electrode, PotentialProblem
from peri.transport.potential.polarization import LinearPolarization, surface_potential

KAPPA = 2.5  # S/m
AE44 = PiecewiseTafelCurve(
    (Tafel(0.014, 0.022019, -1.55), Tafel(21.145, 0.159446, -1.48), Tafel(58.107, 0.400, -1.41)),
    (-1.48, -1.41),
)
STEEL = Tafel(0.00125, -0.153, -0.58)
AA6063 = Tafel(0.142, -0.0701, -1.363)


def slab(thickness, cells, m, left, right, width=None, walls=True):
    """Liquid between two plates, `cells` across; width: nodes along the plates (None: 1D)."""
    h, behind = thickness / cells, m + 1
    shape = (cells + 2 * behind,) + (() if width is None else (width,))
    lattice = Lattice((0.0,) * len(shape), (h,) * len(shape), shape)
    x = np.broadcast_to(np.arange(shape[0]).reshape([-1] + [1] * (len(shape) - 1)) - behind, shape)
    electrodes = [Electrode(x < 0, left), Electrode(x >= cells, right)]
    stencil = diffusion_stencil(lattice, m * h)
    liquid = (x >= 0) & (x < cells)
    return lattice, PotentialProblem(lattice, stencil, liquid, electrodes, KAPPA, walls=walls)


def test_a_problem_that_nobody_holds_any_more_is_freed_at_once():
    """A couple makes one whenever a node is gone; its arrays must not wait for the collector."""
    gc.disable()
    try:
        problem = slab(0.1, 20, 2, AE44, STEEL)[1]
        assert problem.solve().newton > 0
        known = weakref.ref(problem)
        del problem
        assert known() is None
    finally:
        gc.enable()


@pytest.mark.parametrize("m", [1, 2, 4, 8])
def test_a_slab_between_linear_electrodes_is_exact(m):
    """i = 0.5 V / (0.1 m / 2.5 S/m + 2 R_p); 12.5 A/m2 for R_p -> 0."""
    for resistance in (1e-2, 1e-9):
        plates = LinearPolarization(0.1, resistance), LinearPolarization(0.6, resistance)
        lattice, problem = slab(0.1, 40, m, *plates)
        found = problem.solve(tolerance=1e-12)
        exact = 0.5 / (0.04 + 2 * resistance)
        # measured at most 3e-14 for 1e-2; the tolerance
        assert found.current(0) == pytest.approx(exact, rel=1e-10)
        assert found.current(1) == pytest.approx(-exact, rel=1e-10)
        x = lattice.axis(0) - 0.5 * (lattice.axis(0)[0] + lattice.axis(0)[-1])
        inside = np.isfinite(found.potential)
        # current flows from the left plate to the right one, along falling phi
        slope = np.polyfit(x[inside], found.potential[inside], 1)[0]
        assert slope == pytest.approx(-exact / KAPPA, rel=1e-9)
        assert found.newton <= 8


def test_wagner_limits():
    """W = kappa R_p / L of 1e-6: all drop in the liquid; 1e6: all drop at the plates."""
    for wagner in (1e-6, 1e6):
        resistance = wagner * 0.1 / KAPPA
        _, problem = slab(
            0.1, 20, 3, LinearPolarization(0.0, resistance), LinearPolarization(1.0, resistance)
        )
        found = problem.solve(tolerance=1e-12)
        assert found.current(0) == pytest.approx(1.0 / (0.04 + 2 * resistance), rel=1e-9)


def test_plates_with_tafel_laws():
    """AE44's last piece against steel over 10 mm: 44.7105 A/m2 by the scalar equation."""

    def excess(i):
        anode = -1.41 + 0.4 * np.log10(i / 58.107)
        cathode = -0.58 - 0.153 * np.log10(i / 0.00125)
        return cathode - anode - i * 0.01 / KAPPA

    exact = brentq(excess, 1.0, 100.0, xtol=1e-12)
    assert exact == pytest.approx(44.7105, abs=1e-4)
    _, problem = slab(0.01, 20, 3, Tafel(58.107, 0.4, -1.41), STEEL)
    found = problem.solve(tolerance=1e-12)
    assert found.current(0) == pytest.approx(exact, rel=1e-10)
    assert abs(found.imbalance) < 1e-12
    assert found.newton <= 8 and found.iterations <= 8 * 20


def test_walls_beside_a_slab_cost_nothing():
    """Plates of 12 nodes between insulated walls: the whole section conducts; without: 7 % less."""
    plates = LinearPolarization(0.0, 1e-3), LinearPolarization(1.0, 1e-3)
    exact = 1.0 / (0.01 / KAPPA + 2e-3)
    currents = {}
    for walls in (True, False):
        lattice, problem = slab(0.01, 20, 3, *plates, width=12, walls=walls)
        currents[walls] = problem.solve().current(1) / (12 * lattice.spacing[0])
    assert currents[True] == pytest.approx(-exact, rel=1e-2)  # corners remain
    assert abs(currents[False] / currents[True]) < 0.97


def test_missing_moment_along_walls():
    """A strip between two walls: along it, exactly what bonds into the walls would give."""
    lattice = Lattice((0.0, 0.0), (1.0, 2.0), (40, 12))
    stencil = diffusion_stencil(lattice, (3.0, 6.0))
    liquid = np.ones(lattice.shape, bool)
    along, across = Walls(NonlocalSum(stencil, lattice.shape)).missing(liquid)
    offsets = np.arange(-3, 4)
    for j in range(12):
        there = (j + offsets >= 0) & (j + offsets < 12)
        moment = 0.5 * (stencil.dense() * offsets[:, None] ** 2)[:, there].sum()
        # round-off
        assert along[20, j] == pytest.approx(1.0 - moment, abs=1e-12)
        assert across[20, j] == pytest.approx(0.0, abs=1e-12)
    assert along[20, 0] > 0.15 and along[20, 6] == pytest.approx(0.0, abs=1e-12)


def test_a_thin_film_couple():
    """kappa 2.5, film 0.1 mm, R_p 0.01 | 0.1: 0.0368477 A/m, E at the joint -1.316955 V."""
    cells, m, ratio = 6, 2, 10
    h = 1e-4 / cells
    lattice = Lattice(
        (-20e-3 + 0.5 * ratio * h, (0.5 - m) * h),
        (ratio * h, h),
        (round(60e-3 / ratio / h), cells + m),
    )
    x, y = lattice.coordinates()
    metal = np.broadcast_to(y < 0, lattice.shape)
    electrodes = [
        Electrode(metal & (x < 0), LinearPolarization(-1.55, 0.01)),
        Electrode(metal & (x > 0), LinearPolarization(-0.58, 0.1)),
    ]
    stencil = diffusion_stencil(lattice, (m * ratio * h, m * h))
    found = PotentialProblem(lattice, stencil, ~metal, electrodes, KAPPA).solve()
    # measured 6.7e-4 low; without the walls' conduction 10.8 %
    assert found.current(0) == pytest.approx(0.0368477, rel=2e-3)
    near = np.abs(x[:, 0]) < 2 * ratio * h
    joint = -np.nanmean(found.potential[near])
    assert joint == pytest.approx(-1.316955, abs=2e-3)
    plain = PotentialProblem(lattice, stencil, ~metal, electrodes, KAPPA, walls=False).solve()
    assert 0.88 < plain.current(0) / 0.0368477 < 0.91
    assert found.newton <= 8 and found.iterations <= 8 * 20


@pytest.mark.parametrize(
    ("exchange", "tip", "within"),
    # closed form E = E_t - (2/b) ln cos(s x); measured 0.5 %, 0.3 %, 0.1 %
    [(1e-3, -1.259513e-3, 8e-3), (0.1, -49.774663e-3, 5e-3), (10.0, -212.971644e-3, 3e-3)],
)
def test_potential_drop_of_a_crevice(exchange, tip, within):
    """25 um wide, 12.7 mm deep, held at its mouth, 0.1 V a decade, on a lattice of 25:1."""
    cells, m, ratio = 12, 2, 25
    h = 25e-6 / cells
    depth = round(12.7e-3 / (ratio * h))
    lattice = Lattice(
        ((0.5 - m) * ratio * h, (0.5 - m) * h), (ratio * h, h), (depth + m, cells + m)
    )
    x, y = lattice.coordinates()
    liquid = np.broadcast_to(y > 0, lattice.shape)
    wall = Electrode(np.broadcast_to((y < 0) & (x > 0), lattice.shape), Tafel(exchange, 0.1, 0.0))
    held = np.where(liquid & (x < 0), 0.0, np.nan)
    stencil = diffusion_stencil(lattice, (m * ratio * h, m * h))
    found = PotentialProblem(lattice, stencil, liquid, [wall], KAPPA, held=held).solve()
    assert -np.nanmean(found.potential[-1]) == pytest.approx(tip, rel=within)
    assert found.newton <= 8 and found.iterations <= 8 * 20


@pytest.mark.parametrize(
    ("cells", "most"), [(7.5, 0.03), (10, 0.02), pytest.param(20, 0.011, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("resistance", [0.1, 1.0, 10.0])
def test_a_disc_in_a_ring(cells, most, resistance):
    """Staircase disc of 2.5, 3.3 and 6.7 horizons: measured 2.6, 1.7 and 1.0 % at most."""
    m, outer, h = 3, 3.0, 1.0 / cells
    n = int(2 * (outer + m * h) / h) + 4
    lattice = Lattice(((0.5 - 0.5 * n + 0.3) * h, (0.5 - 0.5 * n + 0.17) * h), (h, h), (n, n))
    x, y = lattice.coordinates()
    r = np.hypot(x, y)
    disc, liquid = r < 1.0, (r >= 1.0) & (r < outer + m * h)
    drop = resistance + np.log(outer)
    held = np.where(liquid & (r > outer), -1 - np.log(np.maximum(r, 1.0) / outer) / drop, np.nan)
    electrode = Electrode(disc, LinearPolarization(0.0, resistance))
    stencil = diffusion_stencil(lattice, m * h)
    found = PotentialProblem(lattice, stencil, liquid, [electrode], 1.0, held=held).solve()
    assert found.current(0) == pytest.approx(2 * np.pi / drop, rel=most)


@pytest.mark.parametrize("angle", [0, 20, 45])
def test_plates_of_any_direction(angle):
    """Two plates turned against the lattice: measured within 0.7 %."""
    h, n = 0.01 / 20, 112
    lattice = Lattice((-(n - 1) / 2 * h,) * 2, (h, h), (n, n))
    x, y = lattice.coordinates()
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    u, v = c * x + s * y, -s * x + c * y
    inside = np.abs(v) < 0.012
    liquid = inside & (np.abs(u) < 0.005)
    plates = [inside & (u >= 0.005) & (u < 0.0075), inside & (u <= -0.005) & (u > -0.0075)]
    electrodes = [
        Electrode(p, LinearPolarization(e, 1e-3)) for p, e in zip(plates, (0.0, 1.0), strict=True)
    ]
    stencil = diffusion_stencil(lattice, 3 * h)
    found = PotentialProblem(lattice, stencil, liquid, electrodes, KAPPA).solve()
    node = found.patches.node * h - (n - 1) / 2 * h
    middle = (np.abs(node @ np.array([-s, c])) < 0.007) & (found.patches.electrode == 0)
    assert middle.sum() > 15
    assert found.density[middle].mean() == pytest.approx(1 / (0.01 / KAPPA + 2e-3), rel=1e-2)


PLACES = np.array([1, 5, 9, 11, 15, 19]) * 1e-3


@pytest.mark.parametrize(
    ("cathode", "total", "density"),
    [
        # finite volumes, 20 x 10 mm cell: total current and currents along the surface
        (STEEL, 0.4120, [-28.38, -33.87, -65.47, 63.45, 35.28, 29.45]),
        (AA6063, 0.051414, [-4.486, -4.856, -6.307, 7.869, 4.359, 3.700]),
    ],
)
def test_a_couple_with_ae44_against_finite_volumes(cathode, total, density):
    h, m = 0.25e-3, 3
    lattice = Lattice((0.5 * h, (0.5 - m) * h), (h, h), (80, 40 + m))
    x, y = lattice.coordinates()
    metal = np.broadcast_to(y < 0, lattice.shape)
    electrodes = [Electrode(metal & (x < 0.01), cathode), Electrode(metal & (x > 0.01), AE44)]
    problem = PotentialProblem(
        lattice, diffusion_stencil(lattice, m * h), ~metal, electrodes, KAPPA
    )
    found = problem.solve()
    assert found.current(1) == pytest.approx(total, rel=3e-3)
    assert abs(found.imbalance) < 1e-12
    place = (found.patches.node[:, 0] + 0.5) * h
    order = np.argsort(place)
    along = np.interp(PLACES, place[order], found.density[order])
    np.testing.assert_allclose(along, density, rtol=0.02)
    assert found.newton <= 8 and found.iterations <= 8 * 20
    again = problem.solve(guess=found.potential)
    assert again.newton <= 1
    # other starts end in the same place: the function is convex
    far = problem.solve(guess=np.full(lattice.shape, 3.0))
    np.testing.assert_allclose(far.potential, found.potential, rtol=0, atol=1e-7)


def test_bonds_of_another_kind_and_a_conductivity_that_varies():
    """Layers of 1 and 10 S/m in series, harmonic means: the scalar answer."""
    h, m, cells = 1e-3, 2, 20
    shape = (cells + 2 * (m + 1),)
    lattice = Lattice((0.0,), (h,), shape)
    x = np.arange(shape[0]) - (m + 1)
    liquid = (x >= 0) & (x < cells)
    kappa = np.where(x < cells // 2, 1.0, 10.0)
    stencil = diffusion_stencil(lattice, m * h)
    plates = [
        Electrode(x < 0, LinearPolarization(0.0, 1e-2)),
        Electrode(x >= cells, LinearPolarization(1.0, 1e-2)),
    ]
    bond_sum = NonlocalSum(stencil, shape)
    harmonic = Harmonic(bond_sum, bond_sum.pad(np.where(liquid, kappa, 0.0)), bond_sum.pad(liquid))
    found = PotentialProblem(lattice, stencil, liquid, plates, kappa, operator=harmonic).solve()
    exact = 1.0 / (0.01 / 1.0 + 0.01 / 10.0 + 2e-2)
    # bonds across the jump have the harmonic mean of the ends, not of their parts
    assert found.current(0) == pytest.approx(exact, rel=5e-3)


def test_liquid_that_no_electrode_reaches_has_no_potential():
    _, problem = slab(0.1, 20, 2, LinearPolarization(0.0, 1.0), LinearPolarization(1.0, 1.0))
    lattice = Lattice((0.0,), (1.0,), (30,))
    x = np.arange(30)
    plates = [
        Electrode(x < 3, LinearPolarization(0.0, 1.0)),
        Electrode((x >= 13) & (x < 16), LinearPolarization(1.0, 1.0)),
    ]
    liquid = ((x >= 3) & (x < 13)) | (x >= 20)
    found = PotentialProblem(lattice, diffusion_stencil(lattice, 2.0), liquid, plates, 1.0).solve()
    assert np.isnan(found.potential[20:]).all() and np.isfinite(found.potential[3:13]).all()


def test_one_node_electrodes_carry_current():
    """Two metal nodes in a pool: all currents balance and are finite."""
    lattice = Lattice((0.0, 0.0), (1e-3, 1e-3), (15, 20))
    one, other = np.zeros((2, 15, 20), bool)
    one[7, 5] = other[7, 14] = True
    electrodes = [Electrode(one, Tafel(1.0, 0.06, -1.5)), Electrode(other, STEEL)]
    liquid = ~one & ~other
    found = PotentialProblem(
        lattice, diffusion_stencil(lattice, 3e-3), liquid, electrodes, KAPPA
    ).solve()
    assert found.current(0) > 0 and abs(found.imbalance) < 1e-12


@pytest.mark.parametrize("kappa", [1e-3, 10.0])
@pytest.mark.parametrize("slope", [5e-3, 1.0])
@pytest.mark.parametrize("offset", [-2.0, 2.0])
def test_stiff_electrodes(kappa, slope, offset):
    """Slopes of 5 mV to 1 V a decade, an electrode 2 V off: at most 20 Newton steps, balanced."""
    lattice = Lattice((0.0, 0.0), (1e-3, 1e-3), (20, 13))
    x, y = lattice.coordinates()
    metal = np.broadcast_to(y < 3e-3, lattice.shape)
    electrodes = [
        Electrode(metal & (x < 10e-3), Tafel(1.0, slope, -1.0)),
        Electrode(metal & (x >= 10e-3), Tafel(1.0, -slope, -1.0), potential=offset),
    ]
    found = PotentialProblem(
        lattice, diffusion_stencil(lattice, 3e-3), ~metal, electrodes, kappa
    ).solve()
    assert found.current(0) > 0 and abs(found.imbalance) < 1e-12
    assert found.newton <= 20


def test_surface_potential_is_the_scalar_root():
    """E + R i(E) = E_seen for Tafel laws over 12 decades of resistance, by bisection."""
    rng = np.random.default_rng(1)
    for law in (
        Tafel(1.0, 0.005, -1.0),
        Tafel(1e-3, -0.1, -0.5),
        LinearPolarization(0.2, 3.0),
        AE44,
    ):
        seen = rng.uniform(-3.0, 3.0, 50)
        resistance = 10.0 ** rng.uniform(-9, 3, 50)
        potential, current, slope = surface_potential(law, seen, resistance)
        for e, r, found in zip(seen, resistance, potential, strict=True):
            exact = brentq(
                lambda p, e=e, r=r, law=law: p + r * float(law.current(np.array(p))) - e, -600, 600
            )
            assert found == pytest.approx(exact, abs=1e-10)
        step = 1e-7
        up = surface_potential(law, seen + step, resistance)[1]
        down = surface_potential(law, seen - step, resistance)[1]
        smooth = np.abs(potential[:, None] - np.array([-1.48, -1.41])).min(axis=1) > 1e-3
        np.testing.assert_allclose(
            ((up - down) / (2 * step))[smooth], slope[smooth], rtol=1e-4, atol=1e-6
        )
        # where the law is steep the current is the drop over R: E is exact to 1e-16 only
        gentle = resistance * law.slope(potential) < 1.0
        np.testing.assert_allclose(current[gentle], law.current(potential)[gentle])
        drop = (seen - potential)[~gentle]
        np.testing.assert_allclose((resistance * current)[~gentle], drop)


def test_refusals():
    lattice = Lattice((0.0,), (1.0,), (12,))
    x = np.arange(12)
    stencil = diffusion_stencil(lattice, 2.0)
    liquid = (x >= 3) & (x < 9)
    anode = Electrode(x < 3, Tafel(1.0, 0.1, -1.0))
    with pytest.raises(ValueError, match="a current needs a sink"):
        PotentialProblem(lattice, stencil, liquid, [anode], 1.0).solve()
    with pytest.raises(ValueError, match="conductivity: it must be positive"):
        PotentialProblem(lattice, stencil, liquid, [anode], 0.0)
    with pytest.raises(ValueError, match="3 nodes are named twice"):
        PotentialProblem(lattice, stencil, liquid, [anode, anode], 1.0)
    with pytest.raises(ValueError, match="none of them touches the liquid"):
        PotentialProblem(lattice, stencil, x >= 6, [anode], 1.0)
    with pytest.raises(ValueError, match="resistance: -1"):
        LinearPolarization(0.0, -1)

    class Falling:
        """A law whose current falls."""

        def current(self, potential):
            return -np.asarray(potential)

        def slope(self, potential):
            return -np.ones(np.shape(potential))

    with pytest.raises(ValueError, match="law: its current falls"):
        PotentialProblem(lattice, stencil, liquid, [Electrode(x < 3, Falling())], 1.0).solve()
