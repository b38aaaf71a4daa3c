"""How a scene names the law of the dissolution rate: one word, and numbers where it takes some."""

from __future__ import annotations

import dataclasses

from peri.corrosion.rate_laws import KINETICS as LAWS
from perilife_data import did_you_mean

OF_THE_SET = {("volume_loss", "length")} | {
    (name, "saturation_concentration")
    for name, law in LAWS.items()
    if "saturation_concentration" in (f.name for f in dataclasses.fields(law))
}
"""Numbers of laws that the alloy's parameter set gives unless a scene does."""


def numbers_of(name: str) -> tuple[str, ...]:
    """The numbers of a law of peri.corrosion.rate_laws, SI, `?` where one may be left out."""
    return tuple(
        f.name + "?" * (f.default is not dataclasses.MISSING or (name, f.name) in OF_THE_SET)
        for f in dataclasses.fields(LAWS[name])
    )


KINETICS = {name: numbers_of(name) for name in sorted(LAWS, key=lambda name: name != "volume_loss")}
"""Laws of the rate and their numbers; the default first."""


def kinetics_in_words() -> str:
    """Every law with its numbers, as a person has to know them to write one."""
    laws = (name + f" ({', '.join(n)})" * bool(n) for name, n in KINETICS.items())
    return ", ".join(laws)


def read_kinetics(text: str) -> tuple[str, dict[str, float]]:
    """Name and numbers of a law of the rate, written as NAME:number=value,number=value."""
    name, colon, rest = text.partition(":")
    if name not in KINETICS:
        near = did_you_mean(name, KINETICS)
        raise ValueError(f"kinetics is '{name}'{near}; it must be one of {', '.join(KINETICS)}")
    numbers = {}
    for part in rest.split(",") if colon else ():
        key, _, value = (piece.strip() for piece in part.partition("="))
        if key in numbers:
            raise ValueError(f"kinetics is '{text}'; {key} must be given once")
        try:
            numbers[key] = float(value)
        except ValueError:
            raise ValueError(
                f"kinetics is '{text}'; what follows the name must be number=value,..."
            ) from None
    known = [number.rstrip("?") for number in KINETICS[name]]
    needed = [number for number in KINETICS[name] if not number.endswith("?")]
    if set(numbers) - set(known) or set(needed) - set(numbers):
        takes = ", ".join(KINETICS[name]) or "none"
        raise ValueError(f"kinetics is '{text}'; the numbers of {name} must be {takes}")
    return name, numbers
