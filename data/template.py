"""The file of a new alloy: everything that it may hold, with what must be filled in marked."""

import re

from .load import FILL_IN, list_alloys, load_alloy, load_elements, shipped

_HEAD = """# The alloy {name}: replace every "{mark}", numbers without quotes.
#
# source  a key of references.bib: of the shipped one, or of one in this folder (one field a line)
# where   the table, figure or section in it
# kind    measured, fitted, not_identified, assumed, published, published_uncorrected or derived
# Optional in every table: conditions = "...", note = "..."

name = "{name}"
title = "{mark}"
dissolving_element = "Mg"  # the balance

# One table for each other element, by mass ({elements}); for an
# unalloyed metal [mass_fractions] alone.
"""

_MECHANICS = {
    "charge_number": ("1", "of the dissolved ion: 2 of magnesium"),
    "young_modulus": ("GPa", ""),
    "poisson_ratio": ("1", ""),
    "yield_stress": ("MPa", "The hardening curve (Voce) is fitted through these three."),
    "ultimate_tensile_strength": ("MPa", "engineering stress at maximum force"),
    "uniform_strain": ("1", "engineering strain at maximum force, not at fracture"),
    "q1": ("1", "damage 1/q1 leaves no strength; 1.5 of the Mg-Gd alloys"),
}

_CORROSION = """
# Without the tables below the alloy can be pulled (--immersion 0w), not corroded.  They hold the
# constants of the bi-material model and the scene in which they were fitted, to which they belong.
#
# [corrosion]
# medium = "cell-culture-medium"
#
# [corrosion.scene]
# solid = "{mark}"
# domain = "cylinder"        # or "ball"
# calibration = "closed"     # of the stencil constants, or "discrete"
# saturation = "complementarity"  # or "as_published", "none"
# boundary = "refreshed"     # or "no_flux"
"""

_SCENE = {"nodes": "1", "spacing": "um", "horizon_ratio": "1", "diameter": "mm", "height": "mm"}
_CONSTANTS = {
    "interface_diffusivity": ("m^2/s", "D_int"),
    "liquid_diffusivity": ("m^2/s", "D_liq"),
    "saturation_concentration": ("mol/m^3", "C_sat"),
    "volume_loss_scale": ("1", "l of (5.13)"),
    "kernel_exponent": ("1", "q"),
}


def alloy_template(name: str) -> str:
    """The text of a file for a new alloy; ValueError for a name that it cannot have."""
    check_new_name(name)
    text = _HEAD.format(name=name, mark=FILL_IN, elements=", ".join(load_elements()))
    text += _table("mass_fractions.Zn", "%")
    for key, (unit, words) in _MECHANICS.items():
        text += _table(key, unit, words)
    text += _CORROSION.format(mark=FILL_IN)
    for key, unit in _SCENE.items():
        text += _commented(_table(f"corrosion.scene.{key}", unit))
    for key, (unit, words) in _CONSTANTS.items():
        text += _commented(_table(f"corrosion.{key}", unit, words))
    return text


def alloy_like(name: str, like: str) -> str:
    """The text of a shipped alloy's file under another name, to be changed."""
    check_new_name(name)
    load_alloy(like)  # refuses an unknown one, with the nearest
    text = shipped("alloys")[like].read_text(encoding="utf-8")
    return re.sub(r'(?m)^name = ".*"$', f'name = "{name}"', text, count=1)


def check_new_name(name: str) -> None:
    """Refuse a name that is shipped, or that can be no folder."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._+-]*", name):
        raise ValueError(
            f"alloy name is '{name}'; it must begin with a letter or digit and go on with these, "
            "'.', '_', '+' or '-'"
        )
    for known in list_alloys():
        if name.casefold() == known.casefold():
            raise ValueError(
                f"alloy name is '{name}', which is shipped; it must be another one (to change its "
                f"numbers: perilife alloy new my-{known} --like {known})"
            )


def _table(key: str, unit: str, words: str = "") -> str:
    said = f"# {words}\n" if words else ""
    return (
        f'\n{said}[{key}]\nvalue = "{FILL_IN}"\nunit = "{unit}"\nsource = "{FILL_IN}"\n'
        f'where = "{FILL_IN}"\nkind = "published"\n'
    )


def _commented(text: str) -> str:
    return "".join(f"# {line}".rstrip() + "\n" for line in text.splitlines())
