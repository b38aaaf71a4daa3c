"""What a benchmark returns: one measured quantity with its unit and target."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Result:
    """One measured quantity; target says what is asked of it, or None."""

    quantity: str
    value: float
    unit: str
    target: str | None = None
