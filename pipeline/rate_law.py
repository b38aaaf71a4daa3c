"""How a scene names the law of the dissolution rate: one word, and numbers where it takes some."""

KINETICS = {
    "volume_loss": ("length?",),
    "constant": (),
    "tafel": ("overpotential", "slope"),
    "butler_volmer": (
        "overpotential", "charge_number?", "anodic_transfer?", "cathodic_transfer?", "temperature?"
    ),
}  # fmt: skip
"""Laws of the rate and their numbers, SI, `?` where one may be left out; as in peri.corrosion."""


def read_kinetics(text: str) -> tuple[str, dict[str, float]]:
    """Name and numbers of a law of the rate, written as NAME:number=value,number=value."""
    name, _, rest = text.partition(":")
    if name not in KINETICS:
        raise ValueError(f"kinetics is '{name}'; it must be one of {', '.join(KINETICS)}")
    numbers = {}
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        try:
            numbers[key.strip()] = float(value)
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
