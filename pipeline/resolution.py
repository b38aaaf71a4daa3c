"""The table of resolution presets: the one place that says what quick, standard, fine mean."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Resolution:
    """Sizes and steps of one preset, SI.

    spacing: lattice spacing; horizon: thickness of the corroded layer, a material length
    that stays the same in all presets (MODEL.md 2); rate_change: what controls the time step
    (peri.marching); mesh_size, mesh_size_fine: edge length in the bulk and at thread and slot;
    increment: largest increment of nominal strain in the tensile test.
    """

    spacing: float
    horizon: float
    rate_change: float
    mesh_size: float
    mesh_size_fine: float
    increment: float


RESOLUTIONS: dict[str, Resolution] = {
    "quick": Resolution(100e-6, 200e-6, 0.1, 0.30e-3, 0.20e-3, 0.005),
    "standard": Resolution(50e-6, 200e-6, 0.05, 0.12e-3, 0.07e-3, 0.005),
    "fine": Resolution(200e-6 / 6, 200e-6, 0.025, 0.08e-3, 0.05e-3, 0.0025),
}


def resolution(name: str) -> Resolution:
    """The preset called `name`; ValueError names the known ones."""
    if name not in RESOLUTIONS:
        raise ValueError(
            f"resolution '{name}' is not known; it must be one of {', '.join(RESOLUTIONS)}"
        )
    return RESOLUTIONS[name]
