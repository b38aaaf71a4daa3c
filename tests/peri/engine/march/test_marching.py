"""Time stepping and the orders of the diffusion solver in horizon, spacing and step."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm
from scipy.special import erf, j0, sici

from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.scene import CorrosionScene
from peri.engine.influence import closed_constant, diffusion_stencil
from peri.engine.lattice import Lattice, box_lattice
from peri.engine.march.stepping import GAMMA, TimeStepping, next_step, step_towards
from tests.peri.dense import pair_matrix

DIFFUSIVITY = 1e-9


def liquid_scene(lattice, horizon, boundary="no_flux"):
    return CorrosionScene(
        lattice,
        horizon,
        np.zeros(lattice.shape, bool),
        boundary=boundary,
        liquid_diffusivity=DIFFUSIVITY,
        interface_diffusivity=0.0,
    )


def diffuse(scene, initial, time, steps, scheme):
    """March an initial concentration without metal by the stages that `corrode` uses."""
    problem = BiMaterial(scene, 1e-12)
    value, step = problem.sum.pad(initial), time / steps
    for _ in range(steps):
        if scheme == "backward_euler":
            value = problem.implicit_stage(value, step, value, None, 0.0).concentration
        else:
            first = problem.implicit_stage(value, GAMMA * step, value, None, 0.0).concentration
            right = value + (1 - GAMMA) / GAMMA * (first - value)
            value = problem.implicit_stage(right, GAMMA * step, first, None, 0.0).concentration
    return problem.sum.crop(value)


def orders(errors):
    """Observed orders of errors under halving."""
    return -np.diff(np.log2(np.abs(errors)))


@pytest.mark.parametrize("ratio", [2, 4])
def test_spreading_step_converges_in_the_horizon(ratio):
    """erf(x / (2 sqrt(D t))) from t = 50 s to 100 s, horizon -> 0 at fixed horizon/spacing."""
    half, errors = 4e-3, []
    for cells in (50, 100, 200):
        spacing = 2 * half / cells
        lattice = box_lattice((-half,), (half,), spacing)
        x = lattice.axis(0)
        before, after = (0.5 + 0.5 * erf(x / np.sqrt(4 * DIFFUSIVITY * t)) for t in (50.0, 100.0))
        result = diffuse(liquid_scene(lattice, ratio * spacing), before, 50.0, 60, "sdirk2")
        errors.append(np.abs(result - after)[np.abs(x) < half / 2].max())
    # measured 1.94, 1.99
    assert np.all((orders(errors) > 1.85) & (orders(errors) < 2.1))
    # measured 2.3e-4 (two spacings) and 7.8e-4 (four) of a step of 1
    assert 1e-4 < errors[-1] < {2: 3e-4, 4: 1e-3}[ratio]


@pytest.mark.parametrize("ratio", [2, 4])
def test_decaying_sine_between_zero_layers_shows_the_surface_effect(ratio):
    """sin(pi x/L) exp(-D pi^2 t/L^2) held at zero in a layer as thick as the horizon.

    The odd continuation beyond the edge is replaced by zeros: an error of first order in the
    horizon, in the direction of a wider domain.
    """
    length, errors = 1e-3, []
    time = length**2 / (np.pi**2 * DIFFUSIVITY)
    for cells in (20, 40, 80):
        spacing = length / cells
        layer = ratio * spacing
        lattice = box_lattice((-layer,), (length + layer,), spacing)
        x = lattice.axis(0)
        sine = np.sin(np.pi * x / length) * ((x > 0) & (x < length))
        result = diffuse(liquid_scene(lattice, layer, "refreshed"), sine, time, 40, "sdirk2")
        errors.append(result.max() / (sine.max() * np.exp(-1.0)) - 1.0)
    # measured 0.95 to 0.99
    assert np.all((orders(errors) > 0.9) & (orders(errors) < 1.1))
    # measured 0.0240 (two spacings) and 0.0396 (four)
    assert 0.02 < errors[-1] < 0.045


def symbol(stencil, wave):
    """Decay rate of exp(i k x) under unit diffusivity: sum w (1 - cos k xi)."""
    full = stencil.dense()
    axes = [h * np.arange(-r, r + 1) for h, r in zip(stencil.spacing, stencil.reach, strict=True)]
    phase = sum(k * x for k, x in zip(wave, np.meshgrid(*axes, indexing="ij"), strict=True))
    return float((full * (1 - np.cos(phase))).sum())


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_decay_rate_of_a_sine_converges_in_the_horizon(dimension):
    """Discrete calibration at horizon/spacing = 3: D k^2 with second order."""
    wave = 2 * np.pi * np.array([1.0, 0.5, 0.25])[:dimension]
    errors = []
    for cells in (16, 32, 64):
        lattice = Lattice((0.0,) * dimension, (1 / cells,) * dimension, (1,) * dimension)
        stencil = diffusion_stencil(lattice, 3 / cells)
        errors.append(1 - symbol(stencil, wave) / (wave @ wave))
    # measured 1.962, 1.990 in every dimension
    assert np.all((orders(errors) > 1.9) & (orders(errors) < 2.05))
    assert 0.002 < errors[-1] < 0.0045  # measured 0.0040, 0.0037, 0.0031


def test_closed_calibration_does_not_converge_in_the_horizon():
    """At two spacings in 2D the closed constant leaves 3.6 % (dissertation 3.2.5)."""
    errors = []
    for cells in (64, 256):
        lattice = Lattice((0.0, 0.0), (1 / cells, 1 / cells), (1, 1))
        stencil = diffusion_stencil(lattice, 2 / cells, calibration="closed")
        errors.append(1 - symbol(stencil, (2 * np.pi, 0.0)) / (2 * np.pi) ** 2)
    # measured 0.0380, 0.0363; half the missing second moment 0.0724
    assert errors[0] == pytest.approx(0.038, abs=1e-3)
    assert errors[1] == pytest.approx(0.0724 / 2, abs=1e-3)


def continuous_symbol(dimension, wave):
    """int K (1 - cos k x) / |x|^d dV over the unit ball."""
    constant = float(closed_constant(dimension, 1.0, 0.0, "constant"))
    if dimension == 1:
        return 2 * constant * (np.euler_gamma + np.log(wave) - sici(wave)[1])
    mean = j0 if dimension == 2 else lambda z: np.sinc(z / np.pi)
    sphere = 2 * np.pi if dimension == 2 else 4 * np.pi
    return constant * sphere * quad(lambda r: (1 - mean(wave * r)) / r, 1e-12, 1.0)[0]


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_decay_rate_converges_in_the_spacing_at_fixed_horizon(dimension):
    """Discrete calibration against the continuous nonlocal operator, horizon times k = 2."""
    exact = continuous_symbol(dimension, 2.0)
    errors = []
    for ratio in (2, 4, 8, 16):
        lattice = Lattice((0.0,) * dimension, (1 / ratio,) * dimension, (1,) * dimension)
        wave = (2.0,) + (0.0,) * (dimension - 1)
        errors.append(symbol(diffusion_stencil(lattice, 1.0), wave) / exact - 1)
    # measured 2.01, 2.00, 2.00 (1D); 2.38, 2.22, 1.98 (2D); 2.35, 2.02, 2.04 (3D)
    assert np.all((orders(errors) > 1.9) & (orders(errors) < 2.5))
    # measured -6.1e-4, -3.4e-4, -3.2e-4
    assert 2e-4 < abs(errors[-1]) < 8e-4


@pytest.mark.parametrize(
    ("scheme", "order", "finest"), [("backward_euler", 1, 4.2e-3), ("sdirk2", 2, 2.0e-5)]
)
def test_order_in_the_step(scheme, order, finest):
    """Against the matrix exponential of the lattice operator, no flux through the ends."""
    half = 4e-3
    lattice = box_lattice((-half,), (half,), half / 25)
    scene = liquid_scene(lattice, 2 * half / 25)
    initial = 0.5 + 0.5 * np.cos(np.pi * lattice.axis(0) / half)
    weights = pair_matrix(scene.stencil, lattice.shape)
    operator = DIFFUSIVITY * (weights - np.diag(weights.sum(axis=1)))
    exact = expm(3000.0 * operator) @ initial
    assert np.ptp(exact) < 0.2 * np.ptp(initial)  # most of it has decayed
    errors = [
        np.abs(diffuse(scene, initial, 3000.0, steps, scheme) - exact).max()
        for steps in (8, 16, 32)
    ]
    # measured 0.966, 0.983 and 2.018, 2.008
    assert np.all(np.abs(orders(errors) - order) < 0.06)
    assert errors[-1] == pytest.approx(finest, rel=0.05)  # measured 4.16e-3, 1.97e-5


def test_gamma_makes_the_method_second_order_and_l_stable():
    """Butcher matrix ((g, 0), (1-g, g)): sum b c = 1/2, stability function 0 at infinity."""
    nodes, weights = np.array([GAMMA, 1.0]), np.array([1 - GAMMA, GAMMA])
    assert weights @ nodes == pytest.approx(0.5, abs=1e-15)  # round-off
    z = -1e8
    stages = np.linalg.solve(
        np.eye(2) - z * np.array([[GAMMA, 0.0], [1 - GAMMA, GAMMA]]), np.ones(2)
    )
    assert abs(1 + z * weights @ stages) < 1e-7  # like 4.8/|z|


def test_step_towards_hits_the_target_without_a_sliver():
    assert step_towards(0.0, 10.0, 3.0) == 2.5
    assert step_towards(0.0, 10.0, 10.0) == 10.0
    assert step_towards(0.0, 10.0, 1e9) == 10.0
    # 3 steps of 10/3 may sum to slightly less than 10: no fourth step
    assert step_towards(0.0, 10.0, 10.0 / 3.0 * (1 - 1e-12)) == 10.0 / 3.0


def test_next_step_grows_and_shrinks_within_limits():
    assert next_step(1.0, 0.05, 0.05) == pytest.approx(0.9)  # the safety factor
    assert next_step(1.0, 0.0, 0.05) == 2.0
    assert next_step(1.0, 10.0, 0.05) == 0.2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scheme": "heun"}, "scheme: 'heun'; allowed: forward_euler, backward_euler, sdirk2"),
        ({"step": 0.0}, "step"),
        ({"step": -1.0}, "step"),
        ({"step": float("nan")}, "step"),
        ({"step": float("inf")}, "step"),
        ({"first_step": 0.0}, "first_step"),
        ({"rate_change": 0.0}, "rate_change"),
        ({"rate_change": 1.5}, "rate_change"),
        ({"rate_change": float("nan")}, "rate_change"),
    ],
)
def test_refusals(options, message):
    with pytest.raises(ValueError, match=message):
        TimeStepping(**options)
