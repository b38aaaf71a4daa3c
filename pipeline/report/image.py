"""What a reader of the report learns of the image that a solid was read from."""


def image_rows(image: dict | None) -> list[tuple[str, str]]:
    """Rows of the table on the solid; image: as in geometry.json, None for another solid."""
    if image is None:
        return []
    lengths = " x ".join(f"{1e6 * length:.4g}" for length in image["voxel_size"])
    count = " x ".join(f"{n:,}" for n in image["voxels"])
    rows = [("Image", f"{count} voxels of {lengths} µm")]
    rows.append(("Voxels of metal", f"{image['metal_voxels']:,}"))
    if image["removed_voxels"]:
        bodies, voxels = image["removed_bodies"], image["removed_voxels"]
        left_out = f"{voxels:,} voxels in {bodies:,} bodies that hang on nothing"
        rows.append(("Metal left out", left_out))
    if image["cut_by_edge"]:
        sides = ", ".join(image["cut_by_edge"])
        rows.append(("The solid ends at the image's edge", sides))
    return rows
