"""The templates of the pages, what fills them, and how their text is set."""

import re
from pathlib import Path

import jinja2
from markupsafe import Markup

TEMPLATES = Path(__file__).parent / "templates"


def environment() -> jinja2.Environment:
    """Templates of this package; a name that is not given is an error, not an empty place."""
    found = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters.update(symbol=_symbol, unit=_unit)
    return found


def script(name: str) -> Markup:
    """A script of this project, to stand in the page itself."""
    return Markup((TEMPLATES / name).read_text(encoding="utf-8"))


def _symbol(text: str) -> Markup:
    """`D_int` with int as an index; `q1` likewise."""
    match = re.fullmatch(r"(\w)_?(\w+)", text)
    return Markup("<i>{}</i><sub>{}</sub>").format(*match.groups()) if match else _italic(text)


def _italic(text: str) -> Markup:
    return Markup("<i>{}</i>").format(text)


def _unit(text: str) -> str:
    """`mol/m^3` with a raised 3 and `um` with its Greek letter; `1e-5` is left alone."""
    text = re.sub(r"\bum\b", "µm", text)
    raised = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
    return re.sub(r"\^(-?\d+)", lambda match: match.group(1).translate(raised), text)
