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
            "the force is too large, most before immersion: of the M2 x 4 mm screw held by its "
            "shank, cells of 0.2 to 0.3 mm, by 13 to 16 %; of a slotted pin of 1.6 x 5 mm held by "
            "the slot, cells of 0.6 mm, by 39 % (pipeline/MEASURED.md); so the strength left is "
            "too small",
        )
    ]
