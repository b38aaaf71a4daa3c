"""One stage of the corrosion model against the equations written out pair by pair."""

import numpy as np
import pytest

from peri.corrosion.kinetics import ConstantRate, Exposed, VolumeLossLaw
from peri.corrosion.nodes.bimaterial import BiMaterial
from tests.peri.corrosion.scenes import WEEK, pin
from tests.peri.dense import pair_matrix


def right_side(problem, scene, theta, volume_loss):
    """Dense F of dC/dt = F C on the lattice's nodes; refreshed nodes have empty rows.

    (F C)_i = sum_j D_ij w_ij c_j (C_j - C_i), D_ij = D_liq, D_int g theta of the liquid node, 0.
    """
    weights = pair_matrix(scene.stencil, scene.lattice.shape)
    metal = scene.metal.ravel()
    liquid = (scene.domain & ~scene.metal).ravel()
    rate = scene.base_interface_diffusivity() * scene.kinetics.rate(Exposed(volume_loss))
    across = rate * np.outer(metal, liquid * theta.ravel())
    diffusivity = scene.liquid_diffusivity * np.outer(liquid, liquid) + across + across.T
    coupling = weights * diffusivity * scene.capacity().ravel()[None, :]
    operator = coupling - np.diag(coupling.sum(axis=1))
    operator[scene.refreshed().ravel()] = 0.0
    return operator


CASES = {
    "1D": {"dimension": 1, "cells": 30},
    "2D, no flux": {"dimension": 2, "cells": 14, "boundary": "no_flux"},
    "2D, reach 3": {"dimension": 2, "cells": 16, "ratio": 3},
    "3D": {"dimension": 3, "cells": 9},
    "3D, linear, q": {"cells": 9, "influence": "linear", "kernel_exponent": 0.3},
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("rate", [1e-17, 1e-12, 1e-8])
@pytest.mark.parametrize("law", [ConstantRate(), VolumeLossLaw(0.05)])
def test_stage_without_saturation_is_the_dense_solution(name, rate, law):
    scene = pin(
        **{"saturation": "none", "interface_diffusivity": rate, "kinetics": law, **CASES[name]}
    )
    problem = BiMaterial(scene, 1e-13)
    old, tau = problem.initial_concentration, 0.3 * WEEK
    stage = problem.implicit_stage(old, tau, old, None, 0.0)
    operator = right_side(problem, scene, np.ones(scene.lattice.shape), stage.volume_loss)
    expected = np.linalg.solve(
        np.eye(operator.shape[0]) - tau * operator, problem.sum.crop(old).ravel()
    )
    result = problem.sum.crop(stage.concentration).ravel()
    # with rates of 1e-8 and no way out the stiffness is 1e6: measured up to 2.6e-9
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-8 * scene.solid_concentration)
    assert result[~scene.metal.ravel()].max() > 0
    # the kinetics' V_L is that of the solution (tolerance of the stage: 1e-9)
    assert problem.volume_loss(stage.concentration) == pytest.approx(stage.volume_loss, abs=1e-8)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("saturated", [6.6, 66.0])
def test_complementarity_and_balance_of_every_node(name, saturated):
    """0 <= theta <= 1, C <= C_sat, theta < 1 only at C_sat, and the equations hold with theta."""
    scene = pin(
        **{
            "saturation_concentration": saturated,
            "liquid_diffusivity": 1e-13,
            "interface_diffusivity": 1e-14,
            **CASES[name],
        }
    )
    problem = BiMaterial(scene, 1e-13)
    old, tau = problem.initial_concentration, 0.2 * WEEK
    stage = problem.implicit_stage(old, tau, old, None, 0.0)
    value = problem.sum.crop(stage.concentration)
    theta = problem.sum.crop(problem.put(stage.theta))
    free = scene.domain & ~scene.metal & ~scene.refreshed()
    near = free & (problem.sum.crop(problem.sum(1.0 * problem.metal)) > 0)
    assert (theta[near] < 1).any()
    # measured 2e-4 to 3e-2 at the least
    assert theta[near].min() >= 0 and theta[near].max() <= 1.0
    assert value[free].max() <= saturated * (1 + 1e-9)
    np.testing.assert_allclose(value[near & (theta < 1)], saturated, rtol=1e-12)
    operator = right_side(problem, scene, np.where(near, theta, 1.0), stage.volume_loss)
    defect = value.ravel() - tau * (operator @ value.ravel()) - problem.sum.crop(old).ravel()
    # V_L of the stage is known to 1e-9: measured at most 3e-11
    assert np.abs(defect).max() < 1e-9 * scene.solid_concentration


def test_rates_of_clean_dissolution_are_the_bond_sums_to_the_liquid():
    scene = pin(2, 14)
    weights = pair_matrix(scene.stencil, scene.lattice.shape)
    expected = 1e-15 * (weights @ ~scene.metal.ravel()) * scene.metal.ravel()
    rates = BiMaterial(scene).metal_rates().ravel()
    assert (expected > 0).sum() > 10
    # round-off of 20 terms
    np.testing.assert_allclose(rates, expected, rtol=0, atol=1e-14 * expected.max())


def test_fastest_rate_bounds_the_spectrum():
    """Explicit Euler is stable up to 2/spectral radius; the limit used is 1/row sum, below it."""
    scene = pin(2, 14, interface_diffusivity=1e-10, saturation="none")
    problem = BiMaterial(scene)
    operator = right_side(problem, scene, np.ones(scene.lattice.shape), 0.0)
    radius = np.abs(np.linalg.eigvals(operator)).max()
    assert 0.5 * radius <= problem.fastest_rate() * (1 + 1e-12)
    # measured 0.80 of the radius; not so careful that the step becomes useless
    assert problem.fastest_rate() < 1.5 * radius


def test_explicit_step_is_the_dense_product():
    scene = pin(2, 14, interface_diffusivity=1e-10, saturation="none")
    problem = BiMaterial(scene)
    operator = right_side(problem, scene, np.ones(scene.lattice.shape), 0.0)
    step = 0.9 / problem.fastest_rate()
    old = problem.initial_concentration
    for _ in range(3):
        new, _, _ = problem.explicit_step(old, step, 0.0)
        before = problem.sum.crop(old).ravel()
        expected = before + step * (operator @ before)
        np.testing.assert_allclose(
            problem.sum.crop(new).ravel(), expected, rtol=0, atol=1e-13 * before.max()
        )  # round-off
        old = new


def test_volume_loss_is_mass_lost_by_the_metal():
    """V_L = 1 - sum (C - C_sat) / sum (C_solid - C_sat); below C_sat a node counts as lost."""
    scene = pin(2, 14)
    problem = BiMaterial(scene)
    solid, saturated = scene.solid_concentration, scene.saturation_concentration
    value = problem.initial_concentration.copy()
    assert problem.volume_loss(value) == 0.0
    nodes = np.argwhere(problem.metal)
    value[tuple(nodes[0])] = 0.0
    value[tuple(nodes[1])] = 0.5 * (solid + saturated)
    expected = 1.5 / len(nodes)
    assert problem.volume_loss(value) == pytest.approx(expected, rel=1e-12)  # round-off
    assert problem.dissolve(scene.dissolution.gone(problem, value, None)) == 1
    # the change of phase does not change it
    assert problem.volume_loss(value) == pytest.approx(expected, rel=1e-12)
