"""How many triangles a surface file may have, told from its size and beginning."""

from pathlib import Path

MOST_TRIANGLES = 5_000_000
"""Reading and checking takes 15 us of one core and 0.7 kB a triangle (at 1.3 million of them)."""

_BEGINNING = 1 << 20


def check_triangles(path: Path) -> None:
    """Refuse an STL file of more than MOST_TRIANGLES before it is read whole; ValueError.

    The count of an ASCII file is estimated from its first MiB.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        beginning = file.read(_BEGINNING)
    count = int.from_bytes(beginning[80:84], "little") if len(beginning) >= 84 else 0
    about = ""
    if size != 84 + 50 * count:
        facets = beginning.lower().count(b"endfacet")
        # where none is in the first MiB the file is no STL, or has no fewer bytes than a binary one
        count = size * facets // len(beginning) if facets else size // 50
        about = "about "
    if count > MOST_TRIANGLES:
        raise ValueError(
            f"solid '{path.name}' has {about}{count:,} triangles; it must have at most "
            f"{MOST_TRIANGLES:,}, so make the surface coarser"
        )
