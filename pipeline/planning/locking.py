"""What four-node cells get wrong in a test, in words."""

from fem.quadrature import ELEMENTS
from pipeline.scene.loads import LOADS
from pipeline.scene.mechanics import TensileScene


def locking(test: TensileScene) -> list[tuple[str, str, str]]:
    """What is left out, why, and what it does to the peak; nothing where the cells do not lock."""
    if ELEMENTS[test.element].order > 1:
        return []
    if test.load != "axial":
        return [
            (
                "shear within a cell",
                f"slender four-node cells ({test.element}) lock in shear, ten-node ones do not",
                f"the {LOADS[test.load].reaction} is too large: of a plastic bar in torsion by "
                "59 % with P1, 7 % with P1-Fbar (fem/README.md)",
            )
        ]
    if test.element != "P1":
        return []
    return [
        (
            "plastic flow at constant volume",
            "four-node cells (P1) lock in plastic flow, sound ones more than corroded ones",
            "the force is too large, of the sound screw held by its shank by 13 %, more where "
            "cells are coarse, and the strength left too small (perilife study tensile)",
        )
    ]
