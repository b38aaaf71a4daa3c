"""Maps of ions around the metal, in the plane through the middle of the lattice (Fig. 5.10)."""

import logging
from pathlib import Path

import h5py
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pipeline.report.drawing import FAINT, INK, svg_of

logger = logging.getLogger(__name__)

IONS_FILE = "ions.h5"
"""As pipeline.stages.ions writes it, which is slow to import."""

MAPPED = ("Mg", "H", "HCO3", "HPO4")
"""Species of the source's figure, in its order."""

_WIDTH, _HEIGHT = 9.2, 3.0
"""Inches."""
_SMALL = 1e-2
"""mol/m3 below which a species is shown in µmol/m3."""


def ion_maps(file: Path, alloy: str, name: str) -> str:
    """The last time's concentrations of MAPPED, those that the medium has, as one SVG.

    file : ions.h5.  "" where it cannot be read or has none of them.
    """
    try:
        with h5py.File(file) as content:
            known = [n.decode() for n in content["species_names"][:]]
            shown = [n for n in MAPPED if n in known]
            fields = [content["species"][-1, known.index(n)] for n in shown]
            spacing, origin = content["lattice/spacing"][:], content["lattice/origin"][:]
    except (OSError, KeyError) as error:
        logger.info("%s is not used for maps: %s", file, error)
        return ""
    if not shown or fields[0].ndim != 3:
        return ""
    figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained")
    figure.patch.set_alpha(0.0)
    for axes, species, field in zip(
        np.atleast_1d(figure.subplots(1, len(shown))), shown, fields, strict=True
    ):
        plane = field[:, field.shape[1] // 2, :].T
        low, high = _span(plane)
        unit = "mol/m³"
        if high < _SMALL:
            plane, low, high, unit = 1e6 * plane, 1e6 * low, 1e6 * high, "µmol/m³"
        image = axes.imshow(
            plane,
            origin="lower",
            extent=_extent(origin, spacing, field.shape),
            cmap="viridis",
            vmin=low,
            vmax=high,
            interpolation="nearest",
        )
        axes.set_facecolor(FAINT)
        axes.set_title(f"{species}, {unit}", fontsize=9, color=INK)
        axes.tick_params(colors=INK, labelsize=7.5, width=0.7, length=3)
        for spine in axes.spines.values():
            spine.set_visible(False)
        bar = figure.colorbar(image, ax=axes, shrink=0.8, aspect=25)
        bar.ax.tick_params(colors=INK, labelsize=7.5, width=0.7, length=3)
        bar.outline.set_visible(False)
    words = ", ".join(shown)
    return svg_of(figure, f"ions-{name}", f"Maps of {words} around {alloy}, last immersion time")


def _span(plane: NDArray) -> tuple[float, float]:
    """Limits of the colours; a uniform field has some width, too."""
    low, high = float(np.nanmin(plane)), float(np.nanmax(plane))
    return (low, high) if high > low else (low, low + max(abs(low), 1e-30) * 1e-6)


def _extent(origin: NDArray, spacing: NDArray, shape: tuple[int, ...]) -> tuple[float, ...]:
    """Edges of the plane of the first and the last axis, mm."""
    edges = []
    for axis in (0, 2):
        start = origin[axis] - 0.5 * spacing[axis]
        edges += [1e3 * start, 1e3 * (start + shape[axis] * spacing[axis])]
    return tuple(edges)
