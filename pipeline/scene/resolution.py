"""The resolution presets: the one place that says what quick, standard, fine mean.

Each half, with its measured errors, is read from the table that its study writes: lattice and time
steps from presets.toml (`perilife study corrosion`), mesh, element and increment of the tensile
test from presets_tensile.toml (`perilife study tensile`).
"""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from perilife_data import did_you_mean

PRESETS_FILE = Path(__file__).with_name("presets.toml")
TENSILE_FILE = Path(__file__).with_name("presets_tensile.toml")
NAMES = ("quick", "standard", "fine")


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
class TensileError:
    """Error of the strength left of a preset, relative, as measured on the reference screw.

    error: largest over alloys and immersion times, mesh and increment together; alloys: those
    measured; latest: the last immersion time measured, as typed; processor_seconds: of the longest
    test, None where it was not noted; command: what measured it; parts: by mesh and by increments
    of each alloy; settings: what else it was measured with, in words.
    """

    error: float
    alloys: tuple[str, ...]
    latest: str
    processor_seconds: float | None
    command: str
    parts: dict[str, tuple[float, float]]
    settings: str = ""

    def of(self, alloy: str) -> float:
        """The error for an alloy; of one that was not measured, the largest."""
        return sum(self.parts[alloy]) if alloy in self.parts else self.error


@dataclass(frozen=True)
class Resolution:
    """Sizes and steps of one preset, SI.

    spacing: lattice spacing; horizon: thickness of the corroded layer, a material length
    that stays the same in all presets; rate_change: what controls the time step
    (engine.march.marching); classes: rate classes with which its error was measured; node_error:
    with one rate per node on the same lattice, None where that was not measured; mesh_size,
    mesh_size_fine: edge length in the bulk, and at thread and slot; increment: largest nominal
    strain step of the tensile test.
    """

    spacing: float
    horizon: float
    rate_change: float
    classes: int
    mesh_size: float
    mesh_size_fine: float
    element: str
    increment: float
    corrosion_error: CorrosionError
    node_error: CorrosionError | None
    tensile_error: TensileError


def read_presets(path: Path = PRESETS_FILE, tensile: Path = TENSILE_FILE) -> dict[str, Resolution]:
    """The presets from the files that `perilife study corrosion` and `study tensile` wrote.

    Raises ValueError where a file is not such a table.
    """
    corrosion_part = _read(path, "corrosion", _corrosion)
    tensile_part = _read(tensile, "tensile", _tensile)
    return {name: Resolution(**corrosion_part[name], **tensile_part[name]) for name in NAMES}


def _read(path: Path, study: str, preset: Callable[[dict, str], dict]) -> dict[str, dict]:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        return {name: preset(table, name) for name in NAMES}
    except (tomllib.TOMLDecodeError, KeyError, TypeError) as error:
        raise ValueError(
            f"the presets in '{path}' cannot be read ({error}); they must be the {path.name} "
            f"that `perilife study {study}` writes"
        ) from None


def _corrosion(table: dict, name: str) -> dict:
    entry = table[name]
    measured = entry["measured"]
    time = {alloy: numbers["time_error"] for alloy, numbers in measured.items()}
    cost = (entry["half_error_cost"], entry["half_error_measured"], table["command"])

    def error(lattice: dict[str, float]) -> CorrosionError:
        most = max(time[alloy] + lattice[alloy] for alloy in time)
        return CorrosionError(most, time, lattice, *cost)

    by_nodes = entry.get("lattice_error_by_nodes")
    return {
        "spacing": entry["horizon"] / entry["horizon_ratio"],
        "horizon": entry["horizon"],
        "rate_change": entry["rate_change"],
        "classes": entry["classes"],
        "corrosion_error": error(
            {alloy: numbers["lattice_error"] for alloy, numbers in measured.items()}
        ),
        "node_error": None if by_nodes is None else error(by_nodes),
    }


def _tensile(table: dict, name: str) -> dict:
    entry = table[name]
    numbers = {key: entry[key] for key in ("mesh_size", "mesh_size_fine", "element", "increment")}
    measured = entry["measured"]
    error = TensileError(
        entry["error"],
        tuple(table["alloys"]),
        table["immersion"][-1],
        entry["processor_seconds"],
        table["command"],
        {alloy: (of["mesh_error"], of["increment_error"]) for alloy, of in measured.items()},
    )
    return {**numbers, "tensile_error": error}


RESOLUTIONS: dict[str, Resolution] = read_presets()


def resolution(name: str) -> Resolution:
    """The preset called `name`; ValueError names the known ones."""
    if name not in RESOLUTIONS:
        near = did_you_mean(name, RESOLUTIONS)
        raise ValueError(
            f"resolution '{name}' is not known{near}; it must be one of {', '.join(RESOLUTIONS)}"
        )
    return RESOLUTIONS[name]
