"""The file of a new alloy: everything that it may hold, with what must be filled in marked."""

import re

from .load import list_alloys, load_alloy, load_elements, load_parameter_set, shipped
from .own_files import FILL_IN
from .schema import Quantity

_HEAD = """# The alloy {name}: replace every "{mark}", numbers without quotes.
#
# source  a key of references.bib: of the shipped one, or of one in this folder, as
#             @misc{{our-report-12,
#               author = {{We}},
#               title = {{Tensile tests}},
#               year = {{2026}}
#             }}
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
    "yield_stress": (
        "MPa",
        "0.2 % proof stress. The hardening curve (Voce) is fitted through these three.",
    ),
    "ultimate_tensile_strength": ("MPa", "engineering stress at maximum force"),
    "uniform_strain": ("1", "engineering strain at maximum force, not at fracture"),
    "q1": ("1", "damage 1/q1 leaves no strength; 1.5 of the Mg-Gd alloys"),
}

_CORROSION = """
# Without the tables below the alloy can be pulled (--immersion 0w), not corroded.  They hold the
# constants of the bi-material model and the scene in which they were fitted, to which they belong.
# The numbers are those of {like}, assumed of this alloy: `perilife calibrate` begins there to fit
# your own volume losses, and what it writes (--parameters DIR/parameters.toml) goes before them.
# To use them, take "# " from the beginning of each line from here on:
#     sed -i '/^# .corrosion.$/,$ s/^# \\?//' THIS-FILE.toml
#
# [corrosion]
# medium = "{medium}"
#
# [corrosion.scene]
# solid = "{solid}"
# domain = "{domain}"        # or "ball"
# calibration = "{calibration}"     # of the stencil constants, or "discrete"
# saturation = "{saturation}"  # or "complementarity", "none"
# boundary = "{boundary}"     # or "no_flux"
"""

_START = ("table-5.1", "Mg-5Gd")
_SCENE = {"nodes": "", "spacing": "", "horizon_ratio": "horizon over spacing",
          "diameter": "of the liquid's cylinder", "height": ""}  # fmt: skip
_CONSTANTS = {
    "interface_diffusivity": "D_int: how fast a fresh surface dissolves",
    "liquid_diffusivity": "D_liq",
    "saturation_concentration": "C_sat",
    "volume_loss_scale": "l of (5.13): the volume loss over which the rate falls tenfold",
    "kernel_exponent": "q",
}


def alloy_template(name: str) -> str:
    """The text of a file for a new alloy; ValueError for a name that it cannot have."""
    check_new_name(name)
    text = _HEAD.format(name=name, mark=FILL_IN, elements=", ".join(load_elements()))
    text += _table("mass_fractions.Zn", "%")
    for key, (unit, words) in _MECHANICS.items():
        text += _table(key, unit, words)
    return text + _corrosion_to_begin_with(name)


def _corrosion_to_begin_with(name: str) -> str:
    """The tables of corrosion, commented out, with a shipped alloy's numbers as a fit's start."""
    of_set, like = _START
    begun = load_parameter_set(of_set)
    texts = {key: getattr(begun.scene, key) for key in ("solid", "domain", "calibration",
                                                        "saturation", "boundary")}  # fmt: skip
    text = _CORROSION.format(like=like, medium=begun.medium, **texts)
    constants = begun.for_alloy(like)
    for table, record, keys in (("corrosion.scene", begun.scene, _SCENE),
                                ("corrosion", constants, _CONSTANTS)):  # fmt: skip
        for key, words in keys.items():
            text += _commented(_table(f"{table}.{key}", words=words, given=getattr(record, key)))
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


def _table(key: str, unit: str = "", words: str = "", given: Quantity | None = None) -> str:
    """One table: to fill in, or with a number that is assumed to begin with."""
    said = f"# {words}\n" if words else ""
    if given is None:
        value, source, where, kind = f'"{FILL_IN}"', FILL_IN, FILL_IN, FILL_IN
    else:
        value, unit, kind = repr(given.value), given.unit, "assumed"
        source, where = given.source, f"{given.where}, of {_START[1]}"
    return (
        f'\n{said}[{key}]\nvalue = {value}\nunit = "{unit}"\nsource = "{source}"\n'
        f'where = "{where}"\nkind = "{kind}"\n'
    )


def _commented(text: str) -> str:
    return "".join(f"# {line}".rstrip() + "\n" for line in text.splitlines())
