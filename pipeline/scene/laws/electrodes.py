"""Anode and cathode of the metal as a scene says them: numbers of peri's ElectrodeKinetics."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

from peri.corrosion.electrode_kinetics import BALANCES, ElectrodeKinetics

NUMBERS = tuple(
    f.name + "?" * (f.default is not dataclasses.MISSING)
    for f in dataclasses.fields(ElectrodeKinetics)
    if f.name != "balance"
)
"""Numbers of the law, SI, `?` where one may be left out."""


@dataclass(frozen=True)
class ElectrodeSettings:
    """Numbers of ElectrodeKinetics, SI, always assumed; pH and temperature left out: the medium's.

    balance : how anode and cathode share the charge, of `local`, `mixed` and `applied`.
    """

    balance: str
    numbers: dict[str, float] = field(default_factory=dict)

    def law(self, ph: float, temperature: float) -> ElectrodeKinetics:
        """The law in a medium; raises ValueError for numbers out of range."""
        medium = {"ph_reference": ph, "temperature": temperature}
        return ElectrodeKinetics(balance=self.balance, **{**medium, **self.numbers})

    def in_words(self) -> str:
        """How anode and cathode are joined, for a reader."""
        if self.balance == "local":
            return "anode and cathode at one place, each at the potential where they are equal"
        if self.balance == "mixed":
            return "one potential of the whole metal, where its anodes and cathodes are equal"
        if "applied_potential" in self.numbers:
            return f"the metal held at {self.numbers['applied_potential']:g} V against the medium"
        return f"a current of {self.numbers['applied_current']:g} A from the metal to the medium"


def read_electrodes(text: str) -> ElectrodeSettings:
    """Read `balance=mixed,anodic=1e-3,...`, numbers in SI.

    Raises ValueError with one sentence for another form, a number missing or out of range.
    """
    names = [name.rstrip("?") for name in NUMBERS]
    wanted = (
        f"electrodes is '{text}'; write balance={'|'.join(BALANCES)},NAME=NUMBER,... with numbers "
        f"out of {', '.join(NUMBERS)} (? may be left out)"
    )
    balance, numbers = "", dict[str, float]()
    for part in text.split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if name == "balance" and equals and not balance:
            balance = value
            continue
        if not equals or name not in names or name in numbers:
            raise ValueError(wanted)
        try:
            numbers[name] = float(value)
        except ValueError:
            raise ValueError(wanted) from None
    needed = {name for name in NUMBERS if not name.endswith("?")}
    if needed - set(numbers):
        raise ValueError(wanted)
    settings = ElectrodeSettings(balance or BALANCES[0], numbers)
    try:
        settings.law(7.0, 310.15)
    except ValueError as error:
        raise ValueError(f"electrodes: {error}") from None
    return settings
