"""What the liquid does to the metal's rate, as a scene says it: numbers of assumed factors."""

import math
from dataclasses import dataclass, fields

_SWITCH = {"yes": True, "no": False}


@dataclass(frozen=True)
class FeedbackSettings:
    """Numbers of peri.corrosion.liquid_factors.LiquidFactors, SI; always assumed.

    ph_reference, chloride_reference : None: those of the medium.  inhibitor : whether that of the
    reaction set holds the metal back (peri.corrosion.inhibition).
    """

    ph_order: float = 0.0
    ph_reference: float | None = None
    chloride_order: float = 0.0
    chloride_reference: float | None = None
    layer_thickness: float | None = None
    layer_twice: bool = False
    inhibitor: bool = False

    def in_words(self) -> str:
        """The factors that are not 1, for a reader."""
        said = []
        if self.ph_order:
            said.append(f"pH to the order {self.ph_order:g}")
        if self.chloride_order:
            said.append(f"chloride to the order {self.chloride_order:g}")
        if self.layer_thickness is not None:
            said.append(f"minerals, half the rate at {1e6 * self.layer_thickness:g} um")
        if self.inhibitor:
            said.append("the inhibitor of the reaction set")
        return ", ".join(said)


def read_feedback(text: str) -> FeedbackSettings:
    """Read `ph_order=0.3,layer_thickness=1e-5` and the like, numbers in SI.

    Raises ValueError with one sentence for another form, an unknown name, or a number out of range.
    """
    names = [f.name for f in fields(FeedbackSettings)]
    wanted = f"feedback is '{text}'; write NAME=NUMBER,... with names out of {', '.join(names)}"
    given: dict[str, float | bool] = {}
    for part in text.split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or name not in names or name in given:
            raise ValueError(wanted)
        if name in ("layer_twice", "inhibitor"):
            if value not in _SWITCH:
                raise ValueError(f"feedback: {name} is '{value}'; it must be yes or no")
            given[name] = _SWITCH[value]
            continue
        try:
            number = float(value)
        except ValueError:
            raise ValueError(wanted) from None
        if not math.isfinite(number) or number < 0:
            raise ValueError(f"feedback: {name} is {value}; it must be finite and at least 0")
        if number == 0 and name in ("layer_thickness", "chloride_reference"):
            raise ValueError(f"feedback: {name} is {value}; it must be above 0")
        given[name] = number
    settings = FeedbackSettings(**given)  # type: ignore[arg-type]
    if not settings.in_words():
        raise ValueError(
            f"feedback is '{text}'; one of ph_order, chloride_order and layer_thickness must be "
            "above 0, or inhibitor yes"
        )
    return settings
