"""The resolution presets: the one place that says what quick, standard, fine mean.

Lattice and time steps, with their measured errors, are read from presets.toml, which `perilife
study corrosion` writes; mesh and element of the tensile test stand here.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

PRESETS_FILE = Path(__file__).with_name("presets.toml")


@dataclass(frozen=True)
class CorrosionError:
    """Error of the volume loss of a preset, as measured on the reference screw.

    error: largest relative error over times and alloys; time, lattice: its two parts by alloy;
    half_error_cost: processor time of half the error over that of the preset, with the liquid
    computed; half_error_measured: whether that was measured, else extrapolated; command: what
    measured it.
    """

    error: float
    time: dict[str, float]
    lattice: dict[str, float]
    half_error_cost: float
    half_error_measured: bool
    command: str

    def of(self, alloy: str) -> float:
        """The error for an alloy; of one that the study did not run, the largest."""
        if alloy not in self.time:
            return self.error
        return self.time[alloy] + self.lattice[alloy]


@dataclass(frozen=True)
class TensilePreset:
    """Edge length in the bulk and at thread and slot (m), element, largest nominal strain step.

    error: of the strength left, relative, None where it is not measured.

    Intact screw gripped beyond the slot, force at 10 % strain against 448.4 N of P2 on 7,320
    cells: P1-Fbar 2.3, 1.8, 0.9 % above it on 7,320, 12,067, 30,139 cells; P2 on 3,698 cells
    0.2 % above it; P1 (as published) locks, 8 to 10 % above it.  Corroded for 2 and 4 weeks,
    P1 on 7,320 cells keeps 0.86 and 0.81 of the intact force, P2 on 3,698 cells 0.76 and 0.64.
    quick takes P1 all the same: it is the element that passes the peak of all twelve tests of
    the reference run within minutes; P2 has not been shown to do so at 8 and 24 weeks, and
    P1-Fbar found no equilibrium at 1.3 % strain after 4 weeks.
    """

    mesh_size: float
    mesh_size_fine: float
    element: str
    increment: float
    error: float | None = None


TENSILE = {
    "quick": TensilePreset(0.30e-3, 0.20e-3, "P1", 0.005),
    "standard": TensilePreset(0.20e-3, 0.12e-3, "P2", 0.005),
    "fine": TensilePreset(0.12e-3, 0.08e-3, "P2", 0.0025),
}


@dataclass(frozen=True)
class Resolution:
    """Sizes and steps of one preset, SI.

    spacing: lattice spacing; horizon: thickness of the corroded layer, a material length
    that stays the same in all presets; rate_change: what controls the time step
    (peri.marching); the rest as in TensilePreset.
    """

    spacing: float
    horizon: float
    rate_change: float
    mesh_size: float
    mesh_size_fine: float
    element: str
    increment: float
    corrosion_error: CorrosionError
    tensile_error: float | None = None


def read_presets(path: Path = PRESETS_FILE) -> dict[str, Resolution]:
    """The presets, with lattice and time steps from a file that `perilife study corrosion` wrote.

    Raises ValueError where the file is not such a table.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        return {name: _preset(table, name, tensile) for name, tensile in TENSILE.items()}
    except (tomllib.TOMLDecodeError, KeyError, TypeError) as error:
        raise ValueError(
            f"the presets in '{path}' cannot be read ({error}); they must be the presets.toml "
            "that `perilife study corrosion` writes"
        ) from None


def _preset(table: dict, name: str, tensile: TensilePreset) -> Resolution:
    entry = table[name]
    measured = entry["measured"]
    return Resolution(
        spacing=entry["horizon"] / entry["horizon_ratio"],
        horizon=entry["horizon"],
        rate_change=entry["rate_change"],
        mesh_size=tensile.mesh_size,
        mesh_size_fine=tensile.mesh_size_fine,
        element=tensile.element,
        increment=tensile.increment,
        corrosion_error=CorrosionError(
            entry["error"],
            {alloy: numbers["time_error"] for alloy, numbers in measured.items()},
            {alloy: numbers["lattice_error"] for alloy, numbers in measured.items()},
            entry["half_error_cost"],
            entry["half_error_measured"],
            table["command"],
        ),
        tensile_error=tensile.error,
    )


RESOLUTIONS: dict[str, Resolution] = read_presets()


def resolution(name: str) -> Resolution:
    """The preset called `name`; ValueError names the known ones."""
    if name not in RESOLUTIONS:
        raise ValueError(
            f"resolution '{name}' is not known; it must be one of {', '.join(RESOLUTIONS)}"
        )
    return RESOLUTIONS[name]
