"""Image files: the same numbers at the same places whatever the format, and what is refused."""

import numpy as np
import pytest

from pipeline.geometry.image_files import read_image
from tests.pipeline.geometry.scans import (
    tiff,
    write_mha,
    write_nifti,
    write_nrrd,
    write_slices,
    write_tiff,
)

VOXEL = (5e-6, 6e-6, 8e-6)
FLIPPED = np.diag([-1.0, 1.0, -1.0])
EXCHANGED = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def numbers(kind: str) -> np.ndarray:
    """(6, 4, 12) numbers of all sizes that the type holds; without symmetry."""
    low, high = (-100, 100) if kind in ("i1", "f4") else (0, 200)
    if kind in ("i2", "u2"):
        low, high = (-30000, 30000) if kind == "i2" else (0, 60000)
    return np.random.default_rng(7).integers(low, high, (6, 4, 12)).astype(kind)


FORMATS = {
    "mha": ("a.mha", write_mha, {}),
    "mha-big-endian": ("a.mha", write_mha, {"order": ">"}),
    "mha-packed": ("a.mha", write_mha, {"packed": True}),
    "nrrd": ("a.nrrd", write_nrrd, {}),
    "nrrd-gzip": ("a.nrrd", write_nrrd, {"encoding": "gzip", "order": ">"}),
    "nrrd-bzip2": ("a.nrrd", write_nrrd, {"encoding": "bzip2"}),
    "nifti": ("a.nii", write_nifti, {}),
    "nifti-gz": ("a.nii.gz", write_nifti, {"order": ">"}),
}


@pytest.mark.parametrize("kind", ["u1", "i1", "u2", "i2", "f4"])
@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_numbers_and_the_voxel_size(tmp_path, name, kind):
    file, write, how = FORMATS[name]
    values = numbers(kind)
    write(tmp_path / file, values, VOXEL, **how)
    image = read_image(tmp_path / file)
    turned = values[::-1, ::-1] if write is write_nifti else values  # x and y run the other way
    assert image.values.shape == (6, 4, 12) and np.array_equal(image.values, turned)
    assert image.voxel == pytest.approx(VOXEL, rel=1e-6)  # NIfTI has single precision


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("kind", ["u1", "i1", "u2", "i2", "f4"])
def test_a_stack_of_tiff_gives_the_numbers(tmp_path, kind, order):
    values = numbers(kind)
    write_tiff(tmp_path / "a.tif", values, order=order)
    image = read_image(tmp_path / "a.tif", VOXEL)
    assert np.array_equal(image.values, values) and image.voxel == VOXEL


def test_a_folder_of_slices_is_in_the_order_of_its_numbers(tmp_path):
    values = numbers("u2")  # twelve slices: slice_10 comes after slice_9
    write_slices(tmp_path / "stack", values)
    assert np.array_equal(read_image(tmp_path / "stack", VOXEL).values, values)


def test_a_stack_of_imagej_says_how_large_its_voxels_are(tmp_path):
    write_tiff(tmp_path / "a.tif", numbers("u1"), described=(0.2, 7.5))
    assert read_image(tmp_path / "a.tif").voxel == pytest.approx((5e-6, 5e-6, 7.5e-6), rel=1e-12)


OME = (
    '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image>'
    '<Pixels DimensionOrder="XYZCT" SizeX="6" SizeY="4" SizeZ="12" SizeC="1" SizeT="1" '
    'PhysicalSizeX="5.0" PhysicalSizeY="5.0" PhysicalSizeZ="7.5"/></Image></OME>'
)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (("", ""), (5e-6, 5e-6, 7.5e-6)),
        (('="7.5"', '="7500" PhysicalSizeZUnit="nm"'), "several units"),
        (('X="5.0"', 'X="x"'), "must be three numbers"),
        (('SizeC="1"', 'SizeC="3"'), "has 3 channels; it must have one"),
        ((' PhysicalSizeZ="7.5"', ""), "does not say how large its voxels are"),
    ],
)
def test_an_ome_tiff_says_how_large_its_voxels_are(tmp_path, change, found):
    from PIL import Image

    pages = [Image.fromarray(page) for page in numbers("u1").T]
    path = tmp_path / "a.ome.tif"
    pages[0].save(
        path, save_all=True, append_images=pages[1:], tiffinfo={270: OME.replace(*change)}
    )
    if isinstance(found, str):
        with pytest.raises(ValueError, match=found):
            read_image(path)
        return
    image = read_image(path)
    assert image.voxel == pytest.approx(found, rel=1e-12)
    assert np.array_equal(image.values, numbers("u1"))


def test_vtk_reads_the_same_from_an_mha(tmp_path):
    """An independent reader, of the one format in which it is right (see image_files)."""
    import pyvista

    values = numbers("i2")
    write_mha(tmp_path / "a.mha", values, VOXEL, packed=True, offset=(1e-3, 2e-3, 3e-3))
    theirs, ours = pyvista.read(tmp_path / "a.mha"), read_image(tmp_path / "a.mha")
    assert np.array_equal(theirs["MetaImage"].reshape(values.shape, order="F"), ours.values)
    assert np.allclose(theirs.spacing, np.multiply(1e3, ours.voxel), rtol=1e-12)
    assert np.allclose(theirs.origin, np.multiply(1e3, ours.origin), rtol=1e-12)


@pytest.mark.parametrize("turn", [FLIPPED, EXCHANGED], ids=["flipped", "exchanged"])
@pytest.mark.parametrize("write", [write_mha, write_nrrd, write_nifti])
def test_axes_that_run_backwards_or_are_exchanged_are_put_right(tmp_path, write, turn):
    values = numbers("i2")
    file = {write_mha: "a.mha", write_nrrd: "a.nrrd", write_nifti: "a.nii"}[write]
    write(tmp_path / file, values, VOXEL, turn=turn)
    image = read_image(tmp_path / file)
    signs = [-1.0, -1.0, 1.0] if write is write_nifti else [1.0, 1.0, 1.0]
    steps = np.asarray(signs)[:, None] * turn * VOXEL
    for index in ((0, 0, 0), (5, 3, 11), (2, 1, 7)):  # by place, without a word about axes
        place = steps @ index
        k = tuple(np.rint((place - image.origin) / image.voxel).astype(int))
        assert min(k) >= 0 and image.values[k] == values[index]


def test_a_quaternion_turns_like_its_matrix(tmp_path):
    values, half = numbers("u1"), np.sqrt(0.5)
    write_nifti(tmp_path / "q.nii", values, VOXEL, quaternion=(0.0, 0.0, half))  # 90 degrees
    turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    write_nifti(tmp_path / "m.nii", values, VOXEL, turn=turn)
    first, second = read_image(tmp_path / "q.nii"), read_image(tmp_path / "m.nii")
    assert np.array_equal(first.values, second.values)
    assert first.voxel == pytest.approx(second.voxel, rel=1e-6) and first.values.shape == (4, 6, 12)


def test_the_size_in_the_file_and_the_given_one_must_agree(tmp_path):
    write_mha(tmp_path / "a.mha", numbers("u1"), 5e-6)
    assert read_image(tmp_path / "a.mha", (5.001e-6,) * 3).voxel == (5.001e-6,) * 3
    with pytest.raises(ValueError, match="--voxel is 6 x 6 x 6 um; .* a.mha says, 5 x 5 x 5 um"):
        read_image(tmp_path / "a.mha", (6e-6,) * 3)
    write_mha(tmp_path / "b.mha", numbers("u1"), 1e-3)  # 1 x 1 x 1: nothing was known
    with pytest.raises(ValueError, match="b.mha does not say how large its voxels are"):
        read_image(tmp_path / "b.mha")
    assert read_image(tmp_path / "b.mha", VOXEL).voxel == VOXEL


def _file(path, write, **how):
    write(path, numbers("u2"), VOXEL, **how)
    return path.read_bytes()


ASKEW = np.array([[0.96, -0.28, 0.0], [0.28, 0.96, 0.0], [0.0, 0.0, 1.0]])
DAMAGED = {
    "short.mha": (write_mha, {}, lambda b: b[:-40], "bytes of voxels where 576 are announced"),
    "packed.mha": (write_mha, {"packed": True}, lambda b: b[:-40], "compressed part"),
    "text.mha": (write_mha, {}, lambda b: b"nonsense", "no line ElementDataFile"),
    "away.mha": (write_mha, {}, lambda b: b.replace(b"LOCAL", b"a.raw"), "in another file"),
    "many.mha": (
        write_mha, {}, lambda b: b.replace(b"DimSize = 6", b"DimSize = x"), "must be 3 numbers",
    ),
    "askew.mha": (write_mha, {"turn": ASKEW}, lambda b: b, "axes askew to x, y and z"),
    "flat.mha": (
        write_mha, {}, lambda b: b.replace(b"DimSize = 6", b"DimSize = 1"), "at least 2",
    ),
    "size.mha": (
        write_mha, {}, lambda b: b.replace(b"ing = 0.005", b"ing = nan"), "finite length above 0",
    ),
    "short.nrrd": (write_nrrd, {"encoding": "gzip"}, lambda b: b[:-40], "compressed part"),
    "unit.nrrd": (write_nrrd, {}, lambda b: b.replace(b'"um"', b'"px"'), "voxel size in 'px'"),
    "ascii.nrrd": (write_nrrd, {}, lambda b: b.replace(b": raw", b": ascii"), "encoded as ascii"),
    "block.nrrd": (
        write_nrrd, {}, lambda b: b.replace(b"unsigned short", b"block"), "voxels of 'block'",
    ),
    "text.nrrd": (write_nrrd, {}, lambda b: b"nonsense", "an empty line"),
    "short.nii": (write_nifti, {}, lambda b: b[:-40], "are announced"),
    "text.nii": (write_nifti, {}, lambda b: b"nonsense", "header of NIfTI-1"),
    "text.nii.gz": (write_nifti, {}, lambda b: b"nonsense", "header of NIfTI-1"),
    "short.nii.gz": (write_nifti, {}, lambda b: b[:-40], "compressed part"),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_file_is_refused_in_one_sentence(tmp_path, name):
    write, how, damage, words = DAMAGED[name]
    path = tmp_path / name
    path.write_bytes(damage(_file(path, write, **how)))
    with pytest.raises(ValueError, match=words) as caught:
        read_image(path)
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_what_is_no_stack_of_slices_is_refused(tmp_path):
    from PIL import Image

    good = tiff(numbers("u1").T)
    (tmp_path / "short.tif").write_bytes(good[:100])
    (tmp_path / "text.tif").write_bytes(b"nonsense")
    Image.new("RGB", (4, 4)).save(tmp_path / "colours.tif")
    folder, empty = tmp_path / "several", tmp_path / "empty"
    write_slices(folder, numbers("u1"))
    Image.new("L", (9, 9)).save(folder / "slice_99.tif")
    empty.mkdir()
    for path, words in (
        (tmp_path / "short.tif", "short.tif is damaged or no TIFF"),
        (tmp_path / "text.tif", "text.tif is damaged or no TIFF"),
        (tmp_path / "colours.tif", "colours.tif has colours"),
        (folder, "slice_99.tif has slices of several sizes"),
        (empty, "folder empty has no file"),
    ):
        with pytest.raises(ValueError, match=words):
            read_image(path, VOXEL)
