"""Small images, and files of them in every format, written byte by byte, for the tests of scans."""

import bz2
import gzip
import struct
import zlib
from pathlib import Path

import numpy as np

_MHA = {"i1": "CHAR", "u1": "UCHAR", "i2": "SHORT", "u2": "USHORT", "f4": "FLOAT"}
_NRRD = {"i1": "int8", "u1": "uint8", "i2": "int16", "u2": "unsigned short", "f4": "float"}
_NIFTI = {"i1": 256, "u1": 2, "i2": 4, "u2": 512, "f4": 16}
_TIFF_FORMAT = {"i": 2, "u": 1, "f": 3}


def ball(radius: float, voxel, shift=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Which voxels of a box have their centre in a ball at the box's middle plus `shift` (m)."""
    voxel = np.broadcast_to(voxel, 3)
    counts = np.ceil(2.2 * radius / voxel).astype(int) + 2
    axes = [(np.arange(counts[a]) + 0.5 - counts[a] / 2) * voxel[a] - shift[a] for a in range(3)]
    x, y, z = np.meshgrid(*axes, indexing="ij", sparse=True)
    return x**2 + y**2 + z**2 < radius**2


def _bytes(values: np.ndarray, order: str) -> tuple[str, bytes]:
    kind = values.dtype.str[1:]
    return kind, values.T.astype(order + kind).tobytes()


def write_mha(path: Path, values: np.ndarray, voxel, order="<", packed=False, turn=None, offset=0):
    """values (nx, ny, nz); voxel in m; turn: columns are the directions of the axes."""
    kind, data = _bytes(values, order)
    data = zlib.compress(data) if packed else data
    turn = np.eye(3) if turn is None else np.asarray(turn)
    numbers = {
        "TransformMatrix": turn.T.ravel(),
        "Offset": np.broadcast_to(offset, 3) * 1e3,
        "ElementSpacing": np.broadcast_to(voxel, 3) * 1e3,
        "DimSize": values.shape,
    }
    lines = ["ObjectType = Image", "NDims = 3", "BinaryData = True"]
    lines += [f"BinaryDataByteOrderMSB = {order == '>'}", f"CompressedData = {packed}"]
    lines += [f"{name} = {' '.join(f'{n:g}' for n in value)}" for name, value in numbers.items()]
    lines += [f"CompressedDataSize = {len(data)}"] * packed
    lines += [f"ElementType = MET_{_MHA[kind]}", "ElementDataFile = LOCAL"]
    path.write_bytes("\n".join([*lines, ""]).encode() + data)


def write_nrrd(path: Path, values: np.ndarray, voxel, order="<", encoding="raw", turn=None):
    """values (nx, ny, nz); voxel in m, written in um."""
    kind, data = _bytes(values, order)
    data = {"raw": bytes, "gzip": gzip.compress, "bzip2": bz2.compress}[encoding](data)
    steps = (np.eye(3) if turn is None else np.asarray(turn)) * np.broadcast_to(voxel, 3) * 1e6
    lines = ["NRRD0004", "# a comment", f"type: {_NRRD[kind]}", "dimension: 3"]
    lines += ["space: left-posterior-superior", f"sizes: {' '.join(map(str, values.shape))}"]
    lines += ["space directions: " + " ".join(f"({a:g},{b:g},{c:g})" for a, b, c in steps.T)]
    lines += [f"endian: {'little' if order == '<' else 'big'}", f"encoding: {encoding}"]
    lines += ['space units: "um" "um" "um"', "space origin: (0,0,0)"]
    path.write_bytes("\n".join([*lines, "", ""]).encode() + data)


def write_nifti(path: Path, values: np.ndarray, voxel, order="<", turn=None, quaternion=None):
    """values (nx, ny, nz); voxel in m, written in mm; turn in the frame of the format."""
    kind, data = _bytes(values, order)
    edges = np.broadcast_to(voxel, 3) * 1e3
    head = bytearray(352)
    struct.pack_into(order + "i", head, 0, 348)
    struct.pack_into(order + "8h", head, 40, 3, *values.shape, 1, 1, 1, 1)
    struct.pack_into(order + "2h", head, 70, _NIFTI[kind], 8 * values.itemsize)
    struct.pack_into(order + "4f", head, 76, 1.0, *edges)
    struct.pack_into(order + "f", head, 108, 352.0)
    head[123] = 2
    if turn is not None:
        struct.pack_into(order + "h", head, 254, 1)
        rows = np.hstack([np.asarray(turn) * edges, np.zeros((3, 1))])
        struct.pack_into(order + "12f", head, 280, *rows.ravel())
    if quaternion is not None:
        struct.pack_into(order + "h", head, 252, 1)
        struct.pack_into(order + "3f", head, 256, *quaternion)
    head[344:348] = b"n+1\0"
    content = bytes(head) + data
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)


def tiff(slices: np.ndarray, order="<", described: tuple[str, float] | None = None) -> bytes:
    """A TIFF of pages (pages, rows, columns); described: as ImageJ does, pixels per um, um apart.

    Pillow cannot write small signed integers, and the big-endian order neither.
    """
    kind = slices.dtype.str[1:]
    text = b"ImageJ=1.53\nunit=micron\nspacing=%g\n\0" % described[1] if described else b""
    pixel = (round(1000 * described[0]), 1000) if described else ()
    parts, at = [(b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8)], 8
    for n, page in enumerate(slices):
        data = page.astype(order + kind).tobytes()
        tags = [(256, 4, 1, page.shape[1]), (257, 4, 1, page.shape[0])]
        tags += [(258, 3, 1, 8 * slices.itemsize), (259, 3, 1, 1), (262, 3, 1, 1)]
        begin = at + 2 + 12 * (9 + 3 * bool(described)) + 4
        if described:
            tags += [(270, 2, len(text), begin)]
        tags += [(273, 4, 1, begin + len(text) + 8 * bool(described)), (277, 3, 1, 1)]
        tags += [(279, 4, 1, len(data))]
        if described:
            tags += [(282, 5, 1, begin + len(text)), (283, 5, 1, begin + len(text))]
        tags += [(339, 3, 1, _TIFF_FORMAT[kind[0]])]
        head = struct.pack(order + "H", len(tags))
        for tag, form, count, value in tags:
            short = form == 3
            packed = struct.pack(order + ("HH" if short else "I"), value, *[0] * short)
            head += struct.pack(order + "HHI", tag, form, count) + packed
        body = text + (struct.pack(order + "2I", *pixel) if described else b"") + data
        after = begin + len(body)
        head += struct.pack(order + "I", 0 if n + 1 == len(slices) else after)
        parts.append(head + body)
        at = after
    return b"".join(parts)


def write_tiff(path: Path, values: np.ndarray, **how) -> None:
    """values (nx, ny, nz) as one file of many pages."""
    path.write_bytes(tiff(values.T, **how))


def write_slices(folder: Path, values: np.ndarray) -> None:
    """values (nx, ny, nz) as a folder of files numbered without leading zeros."""
    folder.mkdir()
    for k, page in enumerate(values.T):
        (folder / f"slice_{k}.tif").write_bytes(tiff(page[None]))
