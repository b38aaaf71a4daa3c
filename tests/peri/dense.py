"""The nonlocal sum written down pair by pair, to check the fast ones against."""

import itertools

import numpy as np


def plain_weight(bond, spacing, horizon, kernel_exponent=0.0, influence="constant", constant=1.0):
    """K omega beta dV / |xi|^(d+2q) of one bond on a lattice of equal spacing (Eqs 2.12-2.49, 3.2).

    bond: vector, m; spacing, horizon: m; constant: K.
    """
    length = np.sqrt(sum(x * x for x in bond))
    beta = min(1.0, max(0.0, (horizon + spacing / 2 - length) / spacing))
    omega = 1.0 if influence == "constant" else max(0.0, 1.0 - length / horizon)
    power = len(bond) + 2 * kernel_exponent
    return constant * omega * beta * spacing ** len(bond) / length**power


def plain_moment(dimension, spacing, horizon, **options):
    """sum_j w_ij xi_x^2 over a full neighbourhood for K = 1."""
    reach = int(horizon / spacing + 1)
    return sum(
        plain_weight(np.multiply(n, spacing), spacing, horizon, **options) * (n[0] * spacing) ** 2
        for n in itertools.product(range(-reach, reach + 1), repeat=dimension)
        if any(n)
    )


def pair_matrix(stencil, shape):
    """Dense (N, N) matrix of the weights of every pair of nodes, looked up offset by offset."""
    index = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), -1)
    index = index.reshape(-1, len(shape))
    offset = np.abs(index[:, None, :] - index[None, :, :])
    inside = np.all(offset <= np.array(stencil.reach), axis=2)
    offset[~inside] = 0  # the origin of the octant holds zero
    return stencil.octant[tuple(np.moveaxis(offset, -1, 0))]
