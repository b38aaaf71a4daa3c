"""The liquid of a march as an output time keeps it."""

from __future__ import annotations

import logging

import numpy as np

from peri.coupled.surroundings import Surroundings
from peri.transport.chemistry.speciation import Solution
from peri.transport.liquid import LiquidState

log = logging.getLogger(__name__)


def composition(
    around: Surroundings, found: LiquidState, amounts: np.ndarray, bath: Solution
) -> dict[str, np.ndarray | float]:
    """The liquid's composition on the lattice: whole arrays on the root.

    found : the liquid;  amounts : (M, n) minerals, mol/m3;  bath : what the refreshed layer holds.

    Returns `ph`, `potential` (V), `species` (K, ...) in mol/m3 and `minerals` (M, ...), float32,
    NaN off the computed liquid; `net_charge` (over the ionic strength), `lowest` (concentration,
    mol/m3), `fullest` (largest share of a node's liquid that its minerals would fill), `pockets`,
    `pocket_share`, `largest_potential` (V; its bound where it is left out) and `index_<mineral>`,
    the highest saturation index.
    """
    liquid, space = around.liquid, around.space
    concentration = liquid.neutral_concentration(found)
    edge = bath.concentration[:, 0]
    strength = 0.5 * liquid.chemistry.charge**2 @ concentration
    charge = np.abs(liquid.chemistry.charge @ concentration) / strength
    volt = liquid.thermal_voltage
    left_out = liquid.potential_bound(found) if liquid.options.closure == "none" else 0.0
    fullest = _fullest(around, amounts)

    def on_lattice(values: np.ndarray, held: float) -> np.ndarray:
        return space.processes.gather(space.crop(values, held).astype(np.float32))

    def all_of(rows: np.ndarray, held: np.ndarray) -> np.ndarray:
        # One by one: of a large lattice the species in double precision are gigabytes.
        whole = space.processes.extent(space.sum.lattice_shape)
        shape = whole if space.processes.is_root else (0,)
        out = np.empty((len(rows), *shape), np.float32)
        for place, values, h in zip(out, rows, held, strict=True):
            place[...] = on_lattice(values, float(h))
        return out

    out: dict[str, np.ndarray | float] = {
        "ph": on_lattice(liquid.ph(found), float(bath.ph[0])),
        "potential": on_lattice(volt * found.psi, 0.0),
        "species": all_of(concentration, edge),
        "minerals": all_of(amounts, np.zeros(len(amounts))),
        "net_charge": space.largest(charge),
        "fullest": fullest,
        "lowest": space.lowest(concentration),
        "pockets": float(around.pockets),
        "pocket_share": around.pocket_share,
        "largest_potential": max(left_out, space.largest(np.abs(volt * found.psi))),
    }
    for mineral in liquid.minerals:
        index = mineral.ln_omega(found.ln_component) / np.log(10.0)
        out[f"index_{mineral.name}"] = -space.lowest(-index[mineral.region])
    return out


def _fullest(around: Surroundings, amounts: np.ndarray) -> float:
    """Largest share of a node's liquid that its minerals fill; warned about above 1."""
    space = around.space
    filled = np.zeros(space.n)
    for mineral, amount in zip(around.liquid.chemistry.minerals, amounts, strict=True):
        filled += mineral.molar_volume * amount
    fullest = space.largest(filled)
    if fullest > 1.0 and space.processes.is_root:
        log.warning(
            "minerals take %.3g times the room of the liquid that they are in; they fill no pores "
            "in this model, so ions pass where none would", fullest,
        )  # fmt: skip
    return fullest
