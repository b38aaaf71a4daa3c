"""Input and output of CalculiX, an independent finite element code (Debian: calculix-ccx).

Models are written in mm, N and MPa.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np

from fem.constitutive.hardening import Hardening, flow_stress
from fem.constitutive.material import Material

CCX = shutil.which("ccx")
# CalculiX's order of the mid-edge nodes, as pairs of corners
_EDGES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]


def hardening_table(law: Hardening, largest: float) -> list[tuple[float, float]]:
    """(stress [MPa], plastic strain), linear between.

    200 pairs are the most that CalculiX 2.20 uses rightly.
    """
    strains = np.r_[np.linspace(0, 0.4, 161), np.linspace(0.42, largest, 39)]
    return [(1e-6 * flow_stress(law.kind, law.parameters(), e)[0], e) for e in strains]


def ten_nodes(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All nodes (n, 3) and cells (nc, 10) of straight ten-node cells, in CalculiX's order."""
    edges = np.sort(cells[:, _EDGES].reshape(-1, 2), axis=1)
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    nodes = np.concatenate([points, points[unique].mean(axis=1)])
    return nodes, np.c_[cells, len(points) + number.reshape(len(cells), 6)]


def model(nodes, elements, kind: str, material: Material, largest_strain: float) -> str:
    """Nodes [m], elements of one kind and an elastic-plastic material."""
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{i + 1}, {x:.12g}, {y:.12g}, {z:.12g}" for i, (x, y, z) in enumerate(1e3 * nodes)]
    lines += [f"*ELEMENT, TYPE={kind}, ELSET=ALL"]
    for i, cell in enumerate(elements):
        lines.append(", ".join(map(str, [i + 1, *(cell + 1)])))
    lines += ["*MATERIAL, NAME=M", "*ELASTIC", f"{1e-6 * material.young:.12g}, {material.poisson}"]
    lines.append("*PLASTIC")
    lines += [f"{s:.10g}, {e:.10g}" for s, e in hardening_table(material.hardening, largest_strain)]
    lines.append("*SOLID SECTION, ELSET=ALL, MATERIAL=M")
    return "\n".join(lines) + "\n"


def node_set(name: str, numbers: np.ndarray) -> str:
    """A node set from zero-based numbers."""
    return f"*NSET, NSET={name}\n" + "\n".join(str(n + 1) for n in numbers) + "\n"


def run(folder: Path, text: str, timeout: float) -> dict[str, list[np.ndarray]]:
    """Run a model; rows of every printed table in the order of the increments.

    Returns {"force": (n, 4) of time and total force [N], "displacement": list of (nodes, 3) [m]}.
    """
    (folder / "model.inp").write_text(text)
    done = subprocess.run(
        [CCX, "model"], cwd=folder, capture_output=True, text=True, timeout=timeout
    )
    assert "Job finished" in done.stdout, done.stdout[-2000:]
    forces, displacements, mode, now = [], [], "", 0.0
    for line in (folder / "model.dat").read_text().splitlines():
        words = line.split()
        if "total force" in line:
            mode, now = "force", float(words[-1])
        elif "displacements" in line:
            mode = "displacement"
            displacements.append([])
        elif words and mode == "force":
            forces.append([now, *map(float, words)])
        elif words and mode == "displacement":
            displacements[-1].append([1e-3 * float(word) for word in words[1:]])
    return {
        "force": np.array(forces),
        "displacement": [np.array(rows) for rows in displacements],
    }
