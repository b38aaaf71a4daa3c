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
    """The liquid's composition on the lattice.

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
    # One by one: of a large lattice the species in double precision are gigabytes.
    species = np.empty((len(edge), *space.sum.lattice_shape), np.float32)
    for row, c, e in zip(species, concentration, edge, strict=True):
        row[...] = space.crop(c, e)
    minerals = np.array([space.crop(a, 0.0) for a in amounts], np.float32)
    fullest = _fullest(around, amounts)
    out: dict[str, np.ndarray | float] = {
        "ph": space.crop(liquid.ph(found), float(bath.ph[0])).astype(np.float32),
        "potential": space.crop(volt * found.psi, 0.0).astype(np.float32),
        "species": species,
        "minerals": minerals.reshape(len(amounts), *space.sum.lattice_shape),
        "net_charge": float(charge.max(initial=0.0)),
        "fullest": fullest,
        "lowest": float(concentration.min(initial=np.inf)),
        "pockets": float(around.pockets),
        "pocket_share": around.pocket_share,
        "largest_potential": max(left_out, float(np.abs(volt * found.psi).max(initial=0.0))),
    }
    for mineral in liquid.minerals:
        index = mineral.ln_omega(found.ln_component) / np.log(10.0)
        out[f"index_{mineral.name}"] = float(index[mineral.region].max(initial=-np.inf))
    return out


def _fullest(around: Surroundings, amounts: np.ndarray) -> float:
    """Largest share of a node's liquid that its minerals fill; warned about above 1."""
    filled = np.zeros(around.space.n)
    for mineral, amount in zip(around.liquid.chemistry.minerals, amounts, strict=True):
        filled += mineral.molar_volume * amount
    fullest = float(filled.max(initial=0.0))
    if fullest > 1.0:
        log.warning(
            "minerals take %.3g times the room of the liquid that they are in; they fill no pores "
            "in this model, so ions pass where none would", fullest,
        )  # fmt: skip
    return fullest
