"""Benchmark of the operators: time of a product and of a solution for each kind of bond.

A newcomer adds a kind with one function in KINDS.  All fields are those of one liquid: a box with
a ball of metal cut out of it, held at one side; conductivities vary by a factor of 400, drifts
span 8 RT/F.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice, ball
from peri.engine.operators import Convolution, NonlocalSum, Operator
from peri.engine.solvers import LinearSystem
from peri.schemes.bonds import (
    Exponential,
    Harmonic,
    geometric_conductances,
    mean_conductances,
    square_root_fluxes,
)
from peri.schemes.broken import BrokenBonds, BrokenSum
from peri.schemes.collocation import Collocation
from peri.schemes.tensor import TensorConvolution, tensor_stencils
from pipeline.benches.result import Result

_TOLERANCE = 1e-8
_RUNS = 5


@dataclass
class Liquid:
    """The nodes, and fields on them, that every kind is measured with."""

    sum: NonlocalSum
    there: np.ndarray
    unknown: np.ndarray
    conductivity: np.ndarray
    drift: np.ndarray


def _liquid(edge: int, m: int) -> Liquid:
    shape = (edge,) * 3
    lattice = Lattice((0.0,) * 3, (1.0 / edge,) * 3, shape)
    bond_sum = NonlocalSum(diffusion_stencil(lattice, m / edge), shape)
    x, y, z = lattice.coordinates()
    there = ~ball(lattice, (0.5, 0.5, 0.5), 0.2)
    pad = bond_sum.pad
    here = pad(there)
    return Liquid(
        bond_sum,
        here,
        pad(there & (x >= m / edge)),
        pad(np.exp(3 * np.sin(6 * x) * np.cos(5 * y) + 0 * z)) * here,
        pad(8.0 * (x + 0 * y + 0 * z)) * here,
    )


def _stretched(liquid: Liquid) -> Convolution:
    """The liquid on a lattice of 25:1:1, bonds of as many spacings along each axis."""
    shape, m = liquid.sum.lattice_shape, liquid.sum.stencil.reach[0]
    spacing = (25.0 / shape[0], 1.0 / shape[0], 1.0 / shape[0])
    lattice = Lattice((0.0,) * 3, spacing, shape)
    stencil = diffusion_stencil(lattice, tuple(m * h for h in spacing))
    bond_sum = NonlocalSum(stencil, shape)
    return Convolution(bond_sum, liquid.unknown, liquid.there, symmetric=True)


KINDS: dict[str, Callable[[Liquid], Operator]] = {
    "convolution": lambda q: Convolution(q.sum, q.unknown, q.there, symmetric=True),
    "convolution, 25:1 horizon": _stretched,
    "geometric mean (a convolution)": lambda q: geometric_conductances(
        q.sum, q.conductivity, q.unknown
    ),
    "mean (two convolutions)": lambda q: mean_conductances(q.sum, q.conductivity, q.unknown),
    "harmonic mean, bond by bond": lambda q: Harmonic(q.sum, q.conductivity, q.unknown),
    "harmonic mean, stored": lambda q: Harmonic(q.sum, q.conductivity, q.unknown, stored=True),
    "square-root flux (a convolution)": lambda q: square_root_fluxes(
        q.sum, q.drift, q.there, q.unknown
    ),
    "exponential fitting, bond by bond": lambda q: Exponential(
        q.sum, q.drift, q.there, q.unknown, stored=False
    ),
    "exponential fitting, stored": lambda q: Exponential(q.sum, q.drift, q.there, q.unknown),
    "collocation": lambda q: _collocation(q),
    "convolution, a crack through half of it": lambda q: _cracked(q, 0.5),
    "convolution, a fifth of all bonds broken": lambda q: _cracked(q, None),
}


def _collocation(liquid: Liquid) -> Collocation:
    """One layer of held nodes all around, so that rows near them lack neighbours."""
    shape = liquid.sum.lattice_shape
    unknown = np.zeros(shape, bool)
    unknown[1:-1, 1:-1, 1:-1] = True
    return Collocation(liquid.sum.stencil, shape, np.ones(shape, bool), unknown)


def _cracked(liquid: Liquid, depth: float | None) -> Convolution:
    """Bonds broken across the middle plane down to `depth`, or a fifth of all at random."""
    shape = liquid.sum.lattice_shape
    broken = BrokenBonds(liquid.sum.stencil, shape)
    x, y, _ = np.ogrid[tuple(map(slice, shape))]
    rng = np.random.default_rng(1)

    def rule(offset: np.ndarray) -> np.ndarray:
        if depth is None:
            return rng.random(shape) < 0.2
        middle = shape[0] // 2
        across = (x < middle) != (x + offset[0] < middle)
        return np.broadcast_to(across & (y < depth * shape[1]), shape)

    broken.break_where(rule)
    bond_sum = BrokenSum(liquid.sum.stencil, shape, broken)
    return Convolution(bond_sum, liquid.unknown, liquid.there, symmetric=True)


def _median(work: Callable[[], object]) -> float:
    work()
    times = []
    for _ in range(_RUNS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def operators(edge: int = 64, m: int = 3) -> list[Result]:
    """Every kind on edge^3 nodes with a horizon of m spacings: set-up, product, solution."""
    liquid = _liquid(edge, m)
    rng = np.random.default_rng(2)
    noise = liquid.sum.pad(rng.normal(size=liquid.sum.lattice_shape))
    out = np.zeros(liquid.sum.padded_shape)
    results = [
        Result("unknowns", float(liquid.unknown.sum()), "1"),
        Result("bonds per node", liquid.sum.stencil.bonds, "1"),
    ]
    fastest = None
    for name, make in KINDS.items():
        make(liquid)  # compiles
        start = time.perf_counter()
        operator = make(liquid)
        set_up = time.perf_counter() - start
        rough, unknowns = noise * operator.unknown, operator.unknown.sum()
        product = _median(lambda o=operator, u=rough: o.apply(u, out))
        fastest = fastest or product
        start = time.perf_counter()
        system = LinearSystem(operator)
        hierarchy = time.perf_counter() - start
        x, norm = np.zeros_like(rough), float(np.linalg.norm(rough))
        system.solve(x, rough.copy(), 0.5 * norm)  # compiles
        x[:] = 0.0
        start = time.perf_counter()
        iterations = system.solve(x, rough.copy(), _TOLERANCE * norm)
        seconds = time.perf_counter() - start
        method = "CG" if system.symmetric else "BiCGSTAB, two products each"
        results += [
            Result(f"{name}: set-up", set_up, "s"),
            Result(f"{name}: product", 1e9 * product / unknowns, "ns per unknown"),
            Result(f"{name}: product over the convolution's", product / fastest, "1"),
            Result(f"{name}: set-up of the preconditioner", hierarchy, "s"),
            Result(f"{name}: iterations to 1e-8 ({method})", iterations, "1", "<= 20"),
            Result(f"{name}: solution", 1e6 * seconds / unknowns, "us per unknown"),
        ]
    return [*results, *_tensors(liquid, rng, fastest or 1.0)]


def _tensors(liquid: Liquid, rng: np.random.Generator, fastest: float) -> list[Result]:
    """Odd weights, and forces along the bonds of a vector field."""
    stencil, shape = liquid.sum.stencil, liquid.sum.lattice_shape
    field, out = liquid.sum.pad(rng.normal(size=shape)), np.zeros(liquid.sum.padded_shape)
    even = _median(lambda: liquid.sum(field, out))
    odd_sum = NonlocalSum(tensor_stencils(stencil)[0, 1], shape)
    odd = _median(lambda: odd_sum(field, out))
    tensor = TensorConvolution(stencil, shape, liquid.sum.crop(liquid.there))
    vectors = np.array([liquid.sum.pad(rng.normal(size=shape)) for _ in range(3)])
    forces = np.zeros_like(vectors)
    whole = _median(lambda: tensor.apply(vectors, forces))
    return [
        Result("odd weights: sum over that of even ones", odd / even, "1"),
        Result("tensor, three components: product", whole, "s"),
        Result("tensor: product over the scalar convolution's", whole / fastest, "1"),
    ]


def small_operators() -> list[Result]:
    """The same on 20^3 nodes, two spacings: to see that it works."""
    return operators(20, 2)
