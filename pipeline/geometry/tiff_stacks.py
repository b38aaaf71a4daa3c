"""Stacks of TIFF slices, one file of many pages or a folder of files, by Pillow."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np

_SAMPLE_FORMAT = 339  # 1 unsigned, 2 signed, 3 floating point


def read_tiff_stack(
    path: Path,
) -> tuple[np.ndarray, tuple[float, float, float] | None, str]:
    """Numbers (nx, ny, nz) of a stack, its voxel size and the unit of that, or None and "".

    x is a slice's column, y its row and z the page, or the file in the order of the names (with
    numbers in them by value).  The voxel size is known where ImageJ wrote the file or it is an
    OME-TIFF: the dots per inch that other files carry say how to print them.  ValueError for what
    is no stack of slices of one size with one number a pixel.
    """
    from PIL import Image, UnidentifiedImageError

    files = [path]
    if path.is_dir():
        files = [f for f in path.iterdir() if f.suffix.lower() in (".tif", ".tiff")]
        files.sort(key=lambda f: [int(w) if w.isdigit() else w for w in re.split(r"(\d+)", f.name)])
        if not files:
            raise ValueError(f"folder {path.name} has no file that ends in .tif or .tiff")
    slices, lengths, unit = [], None, ""
    for file in files:
        try:
            with warnings.catch_warnings(action="ignore"), Image.open(file) as picture:
                for page in range(getattr(picture, "n_frames", 1)):
                    picture.seek(page)
                    slices.append(_pixels(picture, file))
                    if slices[-1].shape != slices[0].shape or slices[-1].dtype != slices[0].dtype:
                        raise ValueError(f"{file.name} has slices of several sizes or kinds")
                if file is files[0]:
                    picture.seek(0)
                    lengths, unit = _described_voxel(picture, file)
        except (UnidentifiedImageError, EOFError, OSError, SyntaxError) as error:
            if isinstance(error, OSError) and error.errno is not None:
                raise
            said = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise ValueError(f"{file.name} is damaged or no TIFF image: {said}") from None
    return np.stack(slices).transpose(2, 1, 0), lengths, unit


def _pixels(picture, file: Path) -> np.ndarray:
    """One page (rows, columns); the sign of small integers is as the file says."""
    if len(picture.getbands()) != 1 or picture.mode in ("P", "PA"):
        raise ValueError(f"{file.name} has colours; it must have one number a pixel")
    values = np.asarray(picture)
    signed = picture.tag_v2.get(_SAMPLE_FORMAT, (1,))[0] == 2
    if signed and values.dtype == np.uint8:
        return values.view(np.int8)
    return values.astype(np.uint8) if values.dtype == bool else values


def _described_voxel(picture, file: Path) -> tuple[tuple[float, float, float] | None, str]:
    """Voxel size and unit from the description of the first page, where a program wrote one."""
    text = picture.tag_v2.get(270, "")
    if isinstance(text, str) and text.startswith("ImageJ="):
        return _imagej_voxel(picture, text)
    if isinstance(text, str) and "<OME" in text:
        return _ome_voxel(text, file)
    return None, ""


def _imagej_voxel(picture, text: str) -> tuple[tuple[float, float, float] | None, str]:
    """What ImageJ wrote: pixels per unit in two tags, spacing and unit in the description."""
    lines = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)
    unit = lines.get("unit", "").replace("\\u00B5", "µ")
    across, down = (float(picture.tag_v2.get(tag, 0.0)) for tag in (282, 283))
    apart = re.fullmatch(r"-?(\d+\.?\d*(?:[eE][+-]?\d+)?)", lines.get("spacing", ""))
    if unit in ("", "pixel") or not across > 0 or not down > 0 or apart is None:
        return None, ""
    return (1.0 / across, 1.0 / down, float(apart.group(1))), unit


def _ome_voxel(text: str, file: Path) -> tuple[tuple[float, float, float] | None, str]:
    """The physical size of a pixel that an OME-TIFF has in its XML; um where no unit is given."""
    said = dict(re.findall(r'\b((?:Size|PhysicalSize)\w+)="([^"]*)"', text))
    for name, what in (("SizeC", "channels"), ("SizeT", "times")):
        if said.get(name, "1") != "1":
            raise ValueError(f"{file.name} has {said[name]} {what}; it must have one")
    sizes = [said.get(f"PhysicalSize{axis}", "") for axis in "XYZ"]
    units = {said.get(f"PhysicalSize{axis}Unit", "µm") for axis in "XYZ"}
    if "" in sizes:
        return None, ""
    if len(units) > 1:
        raise ValueError(f"{file.name} has several units of length; it must have one")
    try:
        x, y, z = map(float, sizes)
    except ValueError:
        raise ValueError(
            f"{file.name} has voxels of {' x '.join(sizes)}; it must be three numbers"
        ) from None
    return (x, y, z), units.pop()
