"""A coating of the implant as a person writes it: `factor=0.1,lifetime=28d`."""

from dataclasses import dataclass

from pipeline.scene.checks import check, positive
from pipeline.scene.units import parse_time

_NAMES = ("factor", "lifetime")


@dataclass(frozen=True)
class CoatingScene:
    """What multiplies the law of the rate until `lifetime` (s): factor, 0..1; then 1."""

    factor: float
    lifetime: float

    def __post_init__(self) -> None:
        check(0 <= self.factor <= 1, "coating factor", self.factor, "from 0 to 1")
        positive("coating lifetime", self.lifetime)

    def __str__(self) -> str:
        return f"{self.factor:g} of the rate for {self.lifetime / 86400.0:.4g} days"


def read_coating(text: str) -> CoatingScene:
    """Read `factor=0.1,lifetime=28d`, with `coating:` in front or without.

    Raises ValueError with one sentence for another form, a number or a time out of range.
    """
    wanted = f"coating is '{text}'; write factor=X,lifetime=T, as factor=0.1,lifetime=28d"
    given = {}
    for part in text.removeprefix("coating:").split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or name not in _NAMES or name in given:
            raise ValueError(wanted)
        given[name] = value
    if set(given) != set(_NAMES):
        raise ValueError(wanted)
    try:
        factor = float(given["factor"])
    except ValueError:
        raise ValueError(wanted) from None
    return CoatingScene(factor, parse_time(given["lifetime"], "coating lifetime").seconds)
