"""Where the currents between electrodes flow: patches, pools of liquid, held nodes.

Computed on the root, which holds the whole lattice, and dealt out to the processes by blocks.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from peri.engine.influence import Stencil
from peri.engine.operators import NonlocalSum
from peri.engine.processes import OneProcess
from peri.transport.potential.patches import Patches, surface_patches
from peri.transport.potential.polarization import Polarization
from peri.transport.potential.pools import by_pool, label_pools

log = logging.getLogger(__name__)

WIDEST = 100.0
"""Potential, V, at which a set of electrodes without any zero of its total current is given up."""


class NoSinkError(ValueError):
    """The currents of all electrodes have one sign at every potential."""


@dataclass(frozen=True)
class Electrode:
    """Metal nodes (bool, of the lattice's shape), their law, and the metal's potential V, V."""

    metal: np.ndarray
    law: Polarization
    potential: float = 0.0


@dataclass(frozen=True)
class Placement:
    """What the processes share of a geometry, and each one's part of it.

    patches : all of them; `drawn` and the nodes of `shares` are those of the root's lattice.
    shares : (n, padded nodes of this process).  pool_of_patch (n,).  floating : pools (from 1) that
    carry currents and are not held, bool.  laws, potentials : of the electrodes.
    liquid, held, pool : of this process's block: bool, whether it carries a current; phi of held
    nodes, V, NaN elsewhere; number of its pool.
    """

    patches: Patches
    shares: sparse.csr_matrix
    pool_of_patch: np.ndarray
    floating: np.ndarray
    laws: list[Polarization]
    potentials: np.ndarray
    liquid: np.ndarray
    held: np.ndarray
    pool: np.ndarray


def place(
    stencil: Stencil,
    liquid: np.ndarray | None,
    electrodes: Sequence[Electrode],
    held: np.ndarray | None,
    processes: OneProcess,
) -> Placement:
    """The placement of electrodes in a liquid; arrays of the whole lattice, used on the root only.

    Raises
    ------
    ValueError
        As surface_patches does.
    NoSinkError
        Where no pool of liquid carries a current.
    """
    fields: dict[str, np.ndarray] = {}

    def on_root():
        bond_sum = NonlocalSum(stencil, liquid.shape)
        fixed = np.zeros(liquid.shape, bool) if held is None else np.isfinite(held) & liquid
        patches = surface_patches(bond_sum, liquid, [e.metal for e in electrodes])
        pool = label_pools(bond_sum, np.asarray(liquid, bool))
        patches, of_patch = by_pool(patches, bond_sum.pad(pool))
        alive, floating = _working(patches, electrodes, pool, of_patch, fixed)
        kept = alive[of_patch]
        carries = np.asarray(liquid, bool) & alive[pool]
        dropped = int((liquid & ~carries).sum())
        if dropped:
            log.info("%d liquid nodes have no anode or no cathode: no potential", dropped)
        fields["liquid"], fields["pool"] = carries, np.where(carries, pool, 0)
        fields["held"] = np.where(fixed, held if held is not None else 0.0, np.nan)
        about = [e.law for e in electrodes], np.array([e.potential for e in electrodes])
        return patches.only(kept), of_patch[kept], floating, *about

    patches, of_patch, floating, laws, potentials = processes.on_root(on_root)
    mine = {name: processes.scatter(fields.get(name)) for name in ("liquid", "pool", "held")}
    shares = patches.shares
    if not processes.whole:
        shares = _of_block(shares, stencil, mine["liquid"].shape, processes)
    return Placement(patches, shares, of_patch, floating, laws, potentials, **mine)


def _of_block(
    shares: sparse.csr_matrix, stencil: Stencil, shape: tuple[int, ...], processes: OneProcess
) -> sparse.csr_matrix:
    """The columns of a block's nodes, renumbered as those of its padded array."""
    whole, own = (
        NonlocalSum(stencil, s, processes=processes) for s in (processes.extent(shape), shape)
    )
    rows = sparse.coo_matrix(shares)
    padded = tuple(n + 2 * r for n, r in zip(whole.shape, own.reach, strict=True))
    at = np.array(np.unravel_index(rows.col, padded)).T - np.array(own.reach)
    at -= np.array(processes.start)
    here = ((at >= 0) & (at < np.array(own.shape))).all(axis=1)
    flat = np.ravel_multi_index(tuple((at[here] + np.array(own.reach)).T), own.padded_shape)
    return sparse.csr_matrix(
        (rows.data[here], (rows.row[here], flat)), (shares.shape[0], int(np.prod(own.padded_shape)))
    )


def _working(
    patches: Patches,
    electrodes: Sequence[Electrode],
    pool: np.ndarray,
    of_patch: np.ndarray,
    fixed: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Which pools (from 1) carry currents, and which of these are not held; bool.

    A pool whose currents have one sign at every potential carries none, and one that nothing
    touches has no potential.

    Raises NoSinkError where no pool is left.
    """
    count = int(pool.max(initial=0)) + 1
    held, touched = np.zeros(count, bool), np.zeros(count, bool)
    held[np.unique(pool[fixed])] = True
    touched[of_patch] = True
    nets = []
    for shift in (-WIDEST, 0.0, WIDEST):
        density = np.array(
            [float(e.law.current(np.array(e.potential + shift))) for e in electrodes]
        )[patches.electrode]
        nets.append(np.bincount(of_patch, patches.area * density, count))
    balanced = (nets[0] < 0) & (nets[2] > 0) | (nets[1] == 0)
    alive = held | (touched & balanced)
    alive[0] = False
    if not alive.any():
        raise NoSinkError(
            "electrodes: their currents have one sign at every potential; a current "
            "needs a sink (a cathode, or a held potential)"
        )
    return alive, alive & ~held
