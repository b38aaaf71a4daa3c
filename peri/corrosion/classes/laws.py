"""Laws of the interface that rate classes have, by name."""

from __future__ import annotations

from peri.corrosion.classes.bonds import Bonds, ProportionalBonds
from peri.corrosion.classes.faradaic import FaradaicBonds

CLASS_BONDS: dict[str, type[Bonds]] = {
    "proportional": ProportionalBonds,
    "faradaic": FaradaicBonds,
}
