"""How long an image takes to become a solid: a threaded pin in noise, as a TIFF of many pages."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from pipeline.benches.case import in_own_process
from pipeline.benches.result import Result

CONTRAST, NOISE = 20_000, 2_500
"""Of 16 bit: metal against the rest, and standard deviation of the noise in each voxel; one voxel
in 30,000 is on the wrong side of the threshold, and of these most are left out as islands."""


def image_to_solid(voxels: int = 512) -> list[Result]:
    """Seconds, memory and volumes from the file to lattice and surface, of voxels^3."""
    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        path = Path(place) / "scan.tif"
        metal = write_threaded_pin(path, voxels)
        voxel = 4.2e-3 / voxels
        found = in_own_process(
            "image_to_solid", path=str(path), voxel=voxel, threshold=10_000 + CONTRAST / 2
        )
    wanted = metal * voxel**3
    what = f"image of {voxels}^3 voxels"
    whole = voxels == 512
    near = "-0.5 to 0.5" if whole else None
    return [
        Result(f"{what} to lattice and surface", found["seconds"], "s", "<= 30" if whole else None),
        Result(f"{what}: memory", found["peak_bytes"] / 1e9, "GB", "<= 4" if whole else None),
        Result(f"{what}: V_0 of the surface, less the voxels'",
               100 * (found["surface"] / wanted - 1), "%", near),
        Result(f"{what}: V_0 of the lattice, less the voxels'",
               100 * (found["lattice"] / wanted - 1), "%", near),
        Result(f"{what}: triangles", found["triangles"], "1", None),
    ]  # fmt: skip


def write_threaded_pin(path: Path, voxels: int) -> int:
    """Write the image slice by slice; how many voxels are metal without the noise.

    A pin of 70 % of the width with a single-start thread and a slot at the top.
    """
    from PIL import Image

    random = np.random.default_rng(0)
    across = (np.arange(voxels) + 0.5) / voxels - 0.5
    distance = np.hypot(across[:, None], across)
    turn = np.arctan2(across[:, None], across) / (2 * np.pi)
    metal = 0

    def slices():
        nonlocal metal
        for height in across:
            phase = np.mod(10 * height - turn, 1.0)
            inside = distance < 0.35 - 0.08 * np.minimum(phase, 1 - phase)
            inside &= abs(height) < 0.46
            if height > 0.34:
                inside &= np.abs(across)[:, None] > 0.05
            metal += int(np.count_nonzero(inside))
            grey = 10_000 + CONTRAST * inside + random.normal(0, NOISE, inside.shape)
            yield Image.fromarray(np.maximum(grey, 0).astype(np.uint16))

    pages = slices()
    next(pages).save(path, save_all=True, append_images=pages)
    return metal
