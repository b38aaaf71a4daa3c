"""Memory that a march of metal and ions takes, from the arrays that it holds at once.

Counted with tracemalloc at the peak, in the last sweep for the potential in the last stage of a
step; what is in the table of peri/MEASURED.md.
"""

import numpy as np

from pipeline.scene.scene import Scene
from pipeline.stages.corrosion import LiquidDomain

_DOUBLE = 8.0
_OUTPUT = 4.0
"""Bytes of a number of an output."""


def march_bytes(
    liquid: float, cells: float, species: int, components: int, minerals: int, stages: int
) -> float:
    """Bytes at the peak of a march, those of the idle process left out.

    Parameters
    ----------
    liquid : nodes of the liquid that are not refreshed
    cells : of the lattice with its margin of a horizon on each side
    stages : of a step, 2 for sdirk2, else 1
    """
    # ln_component, X_e; G_m, their rates and active sets; g, psi (LiquidState).
    state = 2 * components + 3 * minerals + 2
    start = 2 * components + minerals + 2
    # Concentrations; X_e and the composition before the sweep; work arrays of a node.
    at_work = state + species + 2 * components + minerals + 15
    per_node = (1 + stages) * state + start + at_work
    # Two systems and their multigrid, phases, concentrations of the metal; minerals and the rest.
    per_cell = 42 + 3 * minerals + 2 * stages * (minerals + 2)
    return _DOUBLE * (per_node * liquid + per_cell * cells)


def ion_memory(scene: Scene, domain: LiquidDomain, nodes: int, metal: int, times: int) -> float:
    """Bytes of a scene's march of metal and ions, all its outputs included.

    nodes, metal : of the domain;  times : at which species, minerals, pH and potential are kept
    """
    ions, horizon = scene.ions, scene.lattice.horizon
    assert ions is not None
    extent = np.subtract(domain.upper, domain.lower)
    held = horizon if scene.domain.boundary == "refreshed" else 0.0
    inner = float(np.prod(np.clip(1.0 - 2.0 * held / extent, 0.0, 1.0)))
    cells = float(np.prod((extent + 2.0 * horizon) / scene.lattice.spacing))
    species, minerals = len(ions.chemistry["charge_number"]), len(ions.minerals)
    components, stages = len(ions.chemistry["components"]), 1 + (scene.corrosion.scheme == "sdirk2")
    at_peak = march_bytes(
        max(0.0, nodes * inner - metal), cells, species, components, minerals, stages
    )
    return at_peak + _OUTPUT * (species + minerals + 2) * cells * times
