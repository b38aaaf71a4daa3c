"""Three-dimensional images from files: MHA, NRRD, NIfTI and stacks of TIFF, as numbers with places.

VTK has readers for all of them, but its NRRD reader (9.7) loses the first axis, its MHA and NIfTI
readers hand out what is missing of a file that was cut short as zeros, and none of them gives the
unit of the voxel size.  The headers are a few lines of text or 348 bytes, so they are read here.
"""

from __future__ import annotations

import bz2
import gzip
import math
import re
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.geometry.tiff_stacks import read_tiff_stack
from pipeline.scene.units import METRES_PER

LARGEST_TURN = 1e-3
"""Sine of the angle up to which an image's axis counts as parallel to an axis of space."""

_METRES_PER = {**METRES_PER, "nm": 1e-9, "micron": 1e-6, "microns": 1e-6, "µm": 1e-6, "μm": 1e-6}


@dataclass(frozen=True)
class Image:
    """Numbers on a box of voxels, along the axes of space.

    values: (nx, ny, nz), any number type.  voxel: edge lengths of a voxel (m).  origin: centre of
    the first voxel (m), in the frame of the file (x to the left, y to the back, z up), 0 where
    the file says nothing.
    """

    values: np.ndarray
    voxel: tuple[float, float, float]
    origin: tuple[float, float, float]


@dataclass(frozen=True)
class _Raw:
    """values (n0, n1, n2) by index; steps (3, 3): column k leads from a voxel to the next along
    index k, m; origin (3,): centre of the first voxel, m; measured: whether the file says how long
    the steps are (else they have length 1)."""

    values: np.ndarray
    steps: np.ndarray
    origin: np.ndarray
    measured: bool


def read_image(path: Path, voxel: tuple[float, float, float] | None = None) -> Image:
    """Read an image file, or a folder of TIFF slices.

    voxel: edge lengths (m) along the axes of space, needed where the file has none and refused
    where it has others (by more than 0.1 %).  Axes that run backwards or are exchanged in the file
    are put right; axes askew to those of space are refused.  ValueError with one sentence.
    """
    if path.is_dir() or path.suffix.lower() in (".tif", ".tiff"):
        values, lengths, unit = read_tiff_stack(path)
        metres = _unit(unit, path) if lengths else 1.0
        steps = np.diag([metres * length for length in lengths or (1.0, 1.0, 1.0)])
        raw = _Raw(values, steps, np.zeros(3), lengths is not None)
    else:
        read = {".mha": _read_mha, ".nrrd": _read_nrrd, ".nii": _read_nifti, ".gz": _read_nifti}
        try:
            raw = read[path.suffix.lower()](path)
        except (EOFError, OSError, zlib.error) as error:
            if isinstance(error, OSError) and error.errno is not None:
                raise
            raise _damaged(path, f"its compressed part cannot be read ({error})") from None
    if min(raw.values.shape) < 2:
        shape = " x ".join(map(str, raw.values.shape))
        raise ValueError(f"{path.name} has {shape} voxels; it must have at least 2 along each axis")
    return _upright(raw, voxel, path)


def _upright(raw: _Raw, voxel: tuple[float, float, float] | None, path: Path) -> Image:
    """Turn the indices of an image along the axes of space."""
    lengths = np.linalg.norm(raw.steps, axis=0)
    if not (np.isfinite(raw.steps).all() and np.isfinite(raw.origin).all() and lengths.all()):
        raise _damaged(path, "its voxel size or origin is not a finite length above 0")
    direction = raw.steps / lengths
    along = np.abs(direction).argmax(axis=0)  # index -> axis of space
    askew = np.abs(direction).copy()
    askew[along, range(3)] = 0.0
    if sorted(along) != [0, 1, 2] or askew.max() > LARGEST_TURN:
        raise ValueError(
            f"{path.name} has axes askew to x, y and z (by {math.degrees(askew.max()):.3g} degrees "
            "and more); they must be parallel, so resample the image along them"
        )
    order = np.argsort(along)  # axis of space -> index
    values = raw.values.transpose(order)
    lengths, sign = lengths[order], np.sign(direction[range(3), order])
    first = np.where(sign < 0, -(np.array(values.shape) - 1.0), 0.0)
    values = values[tuple(slice(None, None, int(s)) for s in sign)]
    if not raw.measured and voxel is None:
        raise ValueError(f"{path.name} does not say how large its voxels are; give --voxel")
    if raw.measured and voxel is not None and not np.allclose(lengths, voxel, rtol=1e-3, atol=0):
        raise ValueError(
            f"--voxel is {_shown(voxel)}; it must be left out or be what {path.name} says, "
            f"{_shown(lengths)}"
        )
    size = np.asarray(lengths if voxel is None else voxel, float)
    origin = (raw.origin if raw.measured else np.zeros(3)) + first * size
    return Image(values, tuple(map(float, size)), tuple(map(float, origin)))


def _shown(lengths) -> str:
    return " x ".join(f"{1e6 * length:.5g}" for length in lengths) + " um"


def _damaged(path: Path, why: str) -> ValueError:
    return ValueError(f"{path.name} is damaged or no {path.suffix[1:].upper()} image: {why}")


def _unit(name: str, path: Path) -> float:
    if name not in _METRES_PER:
        known = ", ".join(_METRES_PER)
        raise ValueError(f"{path.name} gives its voxel size in '{name}'; it must be one of {known}")
    return _METRES_PER[name]


def _measured(lengths) -> bool:
    """Whether a header gives a voxel size: 1 x 1 x 1 is what programs write that know none."""
    return not np.allclose(lengths, 1.0, rtol=0, atol=1e-9)


def _array(data: bytes, kind: np.dtype, shape: list[int], path: Path) -> np.ndarray:
    """The numbers (n0, n1, n2), the first index fastest in the file."""
    if len(shape) != 3 or min(shape) < 1:
        raise ValueError(f"{path.name} has {len(shape)} axes; it must have three, without channels")
    needed = math.prod(shape) * kind.itemsize
    if len(data) < needed:
        raise _damaged(path, f"it has {len(data):,} bytes of voxels where {needed:,} are announced")
    return np.frombuffer(data, kind, math.prod(shape)).reshape(shape[::-1]).T


def _numbers(text: str, count: int, name: str, path: Path) -> list[float]:
    words = text.replace("(", " ").replace(")", " ").replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise _damaged(path, f"'{name}' is '{text}'; it must be {count} numbers")
    return numbers


# --- MHA: lines NAME = VALUE, then the voxels -----------------------------------------------------

_MHA_TYPES = {
    "MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2", "MET_INT": "i4",
    "MET_UINT": "u4", "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8", "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}  # fmt: skip


def _read_mha(path: Path) -> _Raw:
    """MetaImage with the voxels in the same file; lengths are in mm."""
    content = path.read_bytes()
    header, begin = {}, 0
    while "ElementDataFile" not in header:
        end = content.find(b"\n", begin)
        name, equals, value = content[begin:end].decode("latin-1").partition("=")
        if end < 0 or not equals:
            raise _damaged(path, "its header has no line ElementDataFile = LOCAL")
        header[name.strip()] = value.strip()
        begin = end + 1
    if header["ElementDataFile"] != "LOCAL":
        raise ValueError(f"{path.name} keeps its voxels in another file; they must be in the same")
    if header.get("ElementNumberOfChannels", "1") != "1" or header.get("NDims") != "3":
        raise ValueError(f"{path.name} must have three axes and one number a voxel")
    if header.get("BinaryData", "True").lower() != "true":
        raise ValueError(f"{path.name} has its voxels as text; they must be binary")
    kind = header.get("ElementType", "")
    if kind not in _MHA_TYPES:
        raise ValueError(f"{path.name} has voxels of {kind}; it must be {', '.join(_MHA_TYPES)}")
    big = header.get("BinaryDataByteOrderMSB", header.get("ElementByteOrderMSB", "False"))
    order = ">" if big.lower() == "true" else "<"
    shape = [int(n) for n in _numbers(header.get("DimSize", ""), 3, "DimSize", path)]
    data = content[begin:]
    if header.get("CompressedData", "False").lower() == "true":
        data = zlib.decompress(data)
    given = header.get("ElementSpacing", "1 1 1")
    lengths = np.array(_numbers(given, 3, "ElementSpacing", path))
    turn = next((k for k in ("TransformMatrix", "Rotation", "Orientation") if k in header), "")
    matrix = _numbers(header.get(turn, "1 0 0 0 1 0 0 0 1"), 9, turn, path)
    place = next((k for k in ("Offset", "Position", "Origin") if k in header), "")
    origin = np.array(_numbers(header.get(place, "0 0 0"), 3, place, path))
    steps = np.array(matrix).reshape(3, 3).T * lengths  # row k of the file is the axis of index k
    values = _array(data, np.dtype(order + _MHA_TYPES[kind]), shape, path)
    return _Raw(values, 1e-3 * steps, 1e-3 * origin, _measured(lengths))


# --- NRRD: lines NAME: VALUE, an empty line, then the voxels --------------------------------------

_NRRD_TYPES = {
    "i1": "signed char, int8, int8_t",
    "u1": "uchar, unsigned char, uint8, uint8_t",
    "i2": "short, short int, signed short, signed short int, int16, int16_t",
    "u2": "ushort, unsigned short, unsigned short int, uint16, uint16_t",
    "i4": "int, signed int, int32, int32_t",
    "u4": "uint, unsigned int, uint32, uint32_t",
    "i8": "longlong, long long, long long int, signed long long, int64, int64_t",
    "u8": "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t",
    "f4": "float",
    "f8": "double",
}
_AXES = {"left": 1, "right": -1, "posterior": 1, "anterior": -1, "superior": 1, "inferior": -1}
_SPACES = {"RAS": "right-anterior-superior", "LAS": "left-anterior-superior"}
_SPACES["LPS"] = "left-posterior-superior"


def _read_nrrd(path: Path) -> _Raw:
    """Nearly raw raster data with the voxels in the same file; mm unless a unit is given."""
    content = path.read_bytes()
    end = re.search(rb"\r?\n\r?\n", content)
    if not content.startswith(b"NRRD") or end is None:
        raise _damaged(path, "it does not begin with a header that an empty line ends")
    lines = content[: end.start()].decode("latin-1").splitlines()[1:]
    header = {}
    for line in lines:
        name, colon, value = line.partition(":")
        if colon and not line.startswith("#"):
            header[name.strip().lower()] = value.strip().lstrip("=").strip()
    if {"data file", "datafile"} & set(header):
        raise ValueError(f"{path.name} keeps its voxels in another file; they must be in the same")
    types = {name: code for code, names in _NRRD_TYPES.items() for name in names.split(", ")}
    kind = header.get("type", "")
    if kind not in types:
        raise ValueError(f"{path.name} has voxels of '{kind}'; it must be an integer or a float")
    skipped = [header.get(n, "0") for n in ("line skip", "lineskip", "byte skip", "byteskip")]
    if set(skipped) != {"0"}:
        raise ValueError(f"{path.name} skips lines or bytes before its voxels; it must not")
    order = ">" if header.get("endian", "little") == "big" else "<"
    dtype = np.dtype(order + types[kind])
    if header.get("dimension") != "3":
        raise ValueError(f"{path.name} must have three axes and one number a voxel")
    shape = [int(n) for n in _numbers(header.get("sizes", ""), 3, "sizes", path)]
    encoding, data = header.get("encoding", "raw"), content[end.end() :]
    if encoding in ("gzip", "gz"):
        data = gzip.decompress(data)
    elif encoding in ("bzip2", "bz2"):
        data = bz2.decompress(data)
    elif encoding != "raw":
        raise ValueError(f"{path.name} is encoded as {encoding}; it must be raw, gzip or bzip2")
    origin, sign = np.zeros(3), np.ones(3)
    if "space directions" in header:
        text = header["space directions"]
        steps = np.array(_numbers(text, 9, "space directions", path)).reshape(3, 3).T
        space = header.get("space", "")
        names = _SPACES.get(space, space).split("-")
        sign = np.array([_AXES.get(word, 1) for word in names] if len(names) == 3 else [1, 1, 1])
        if "space origin" in header:
            origin = np.array(_numbers(header["space origin"], 3, "space origin", path))
    else:
        steps = np.diag(_numbers(header.get("spacings", "1 1 1"), 3, "spacings", path))
    units = set(re.findall(r'"([^"]*)"', header.get("space units", header.get("units", ""))))
    if len(units) > 1:
        raise ValueError(f"{path.name} has several units of length; it must have one")
    metres = _unit(units.pop() or "mm", path) if units else 1e-3
    known = _measured(np.linalg.norm(steps, axis=0)) or "space units" in header
    values = _array(data, dtype, shape, path)
    return _Raw(values, metres * sign[:, None] * steps, metres * sign * origin, known)


# --- NIfTI-1: 348 bytes, then the voxels ----------------------------------------------------------

_NIFTI_TYPES = {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4",
                1024: "i8", 1280: "u8"}  # fmt: skip


def _read_nifti(path: Path) -> _Raw:
    """NIfTI-1 in one file, compressed or not; mm where its unit is unknown.

    Its frame has x to the right and y to the front, which is turned to that of the others.
    """
    content = path.read_bytes()
    if content[:2] == b"\x1f\x8b":
        content = gzip.decompress(content)
    order = next((o for o in "<>" if content[:4] == np.array(348, o + "i4").tobytes()), "")
    if not order or len(content) < 352 or content[344:347] != b"n+1":
        raise _damaged(path, "it does not begin with the header of NIfTI-1")

    def field(kind: str, at: int, count: int) -> np.ndarray:
        return np.frombuffer(content, order + kind, count, at)

    dim, lengths = field("i2", 40, 8), field("f4", 76, 8).astype(float)
    if dim[0] < 3 or (dim[4 : dim[0] + 1] > 1).any():
        raise ValueError(f"{path.name} must have three axes and one number a voxel")
    code = int(field("i2", 70, 1)[0])
    if code not in _NIFTI_TYPES:
        raise ValueError(f"{path.name} has voxels of type {code}; it must be an integer or a float")
    begin = int(field("f4", 108, 1)[0])
    shape = [int(n) for n in dim[1:4]]
    values = _array(content[begin:], np.dtype(order + _NIFTI_TYPES[code]), shape, path)
    slope, intercept = field("f4", 112, 2).tolist()
    if math.isfinite(slope) and slope != 0 and (slope, intercept) != (1.0, 0.0):
        values = values * np.float32(slope) + np.float32(intercept)
    form, affine = field("i2", 252, 2), field("f4", 256, 18).astype(float)
    edges, origin = lengths[1:4], np.zeros(3)
    steps = np.diag(edges)
    if form[1] > 0:
        matrix = affine[6:].reshape(3, 4)
        steps, origin = matrix[:, :3], matrix[:, 3]
    elif form[0] > 0:
        steps = _rotation(*affine[:3]) * edges * [1.0, 1.0, -1.0 if lengths[0] < 0 else 1.0]
        origin = affine[3:6]
    metres = {1: 1.0, 3: 1e-6}.get(content[123] & 7, 1e-3)
    known = _measured(edges) or content[123] & 7 in (1, 3)
    steps, origin = (metres * np.array([-1.0, -1.0, 1.0]) * a for a in (steps.T, origin))
    return _Raw(values, steps.T, origin, known)


def _rotation(b: float, c: float, d: float) -> np.ndarray:
    """The rotation of a unit quaternion with these last three parts."""
    a = math.sqrt(max(0.0, 1.0 - b * b - c * c - d * d))
    return np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - c * c - b * b],
        ]
    )
