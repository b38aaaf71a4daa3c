"""A solid from an image: what has to be said of it, and the options that say it."""

from __future__ import annotations

import argparse
import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

from pipeline.scene.checks import check, positive
from pipeline.scene.units import parse_length

SUFFIXES = (".tif", ".tiff", ".mha", ".nrrd", ".nii", ".nii.gz")


@dataclass(frozen=True)
class ImageFile:
    """The metal that a three-dimensional image shows; sha256 is that of its content.

    path: of a file, or of a folder of TIFF slices.  voxel: edge lengths of a voxel along x, y and
    z (m), None where the file says them.  Metal is what has a value of `threshold` or more, or
    the value `label`.  cap: whether metal that reaches the image's edge ends there.
    """

    path: str
    sha256: str
    voxel: tuple[float, float, float] | None = None
    threshold: float | None = None
    label: int | None = None
    cap: bool = False
    kind: str = "image"

    def __post_init__(self) -> None:
        for length in self.voxel or ():
            positive("voxel", length)
        check(self.voxel is None or len(self.voxel) == 3, "voxel", self.voxel, "one length an axis")
        given = (self.threshold is None) + (self.label is None)
        check(given == 1, "threshold and label", "both or none given", "one of them")
        finite = self.threshold is None or math.isfinite(self.threshold)
        check(finite, "threshold", self.threshold, "a finite number")


def add_image_options(group: argparse._ArgumentGroup) -> None:
    """Add the options of a solid from an image."""
    group.add_argument(
        "--image",
        metavar="FILE",
        help="metal that an image shows instead: TIFF (of many pages, or a folder of slices), "
        "MHA, NRRD, NIfTI; z is the axis of the load",
    )
    group.add_argument(
        "--voxel", nargs="+", metavar="LENGTH", help="of the image: one, or along x, y and z"
    )
    group.add_argument("--threshold", type=float, metavar="X", help="metal: this value or more")
    group.add_argument("--label", type=int, metavar="N", help="metal: this value")
    group.add_argument(
        "--cap", action="store_true", help="metal at the image's edge ends there (else refused)"
    )


def image_from_options(options: argparse.Namespace) -> ImageFile | None:
    """The image that the options name, or None; ValueError or OSError with one sentence."""
    given = {"voxel": options.voxel, "threshold": options.threshold, "label": options.label}
    given = [name for name, value in given.items() if value is not None] + ["cap"] * options.cap
    if options.image is None:
        if given:
            raise ValueError(f"--{given[0]} goes with --image, which must be given too")
        return None
    path = Path(options.image)
    if not path.exists():
        raise FileNotFoundError(f"image is '{path}'; there is no such file or folder")
    if not path.is_dir() and not path.name.lower().endswith(SUFFIXES):
        raise ValueError(
            f"image is '{path}'; it must be a folder of TIFF slices or end in {', '.join(SUFFIXES)}"
            + "; a header with its voxels in another file must be saved as one file of these"
            * path.name.lower().endswith((".mhd", ".nhdr"))
        )
    if (options.threshold is None) == (options.label is None):
        raise ValueError("of --threshold and --label one must be given with --image")
    voxel = None
    if options.voxel is not None:
        lengths = [parse_length(text, "voxel") for text in options.voxel]
        if len(lengths) not in (1, 3):
            raise ValueError(
                f"--voxel is {' '.join(options.voxel)}; it must be one length, or three"
            )
        voxel = tuple(lengths * 3 if len(lengths) == 1 else lengths)
    sha256 = content_of(path)
    return ImageFile(
        str(path.resolve()), sha256, voxel, options.threshold, options.label, options.cap
    )


def content_of(path: Path) -> str:
    """SHA-256 of a file, or of those of the files of a folder in the order of their names."""
    if not path.is_dir():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    digests = [f"{f.name} {content_of(f)}" for f in sorted(path.iterdir()) if f.is_file()]
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()
