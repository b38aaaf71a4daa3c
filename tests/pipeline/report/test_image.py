"""What the report says of the image that a solid was read from."""

from pipeline.report.image import image_rows

FACTS = {
    "voxels": [512, 512, 1024],
    "voxel_size": [5e-6, 5e-6, 7.5e-6],
    "metal_voxels": 1234567,
    "removed_bodies": 3,
    "removed_voxels": 12,
    "cut_by_edge": ["-z", "+z"],
}


def test_islands_and_cuts_are_said() -> None:
    assert image_rows(FACTS) == [
        ("Image", "512 x 512 x 1,024 voxels of 5 x 5 x 7.5 µm"),
        ("Voxels of metal", "1,234,567"),
        ("Metal left out", "12 voxels in 3 bodies that hang on nothing"),
        ("The solid ends at the image's edge", "-z, +z"),
    ]


def test_a_clean_image_has_two_rows_and_another_solid_none() -> None:
    clean = FACTS | {"removed_bodies": 0, "removed_voxels": 0, "cut_by_edge": []}
    assert len(image_rows(clean)) == 2
    assert image_rows(None) == []
