"""Files of one's own: one kind given for another, a name without its ending, what is not filled in.

The files do not say their kind; whatever reads one asks for the keys of its own.
"""

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

FILL_IN = "FILL IN"
"""Stands in place of what template.py leaves open; a file that still holds it is refused."""

MARKS: dict[str, frozenset[str]] = {
    "alloy": frozenset({"dissolving_element"}),
    "parameter set": frozenset({"alloys"}),
    "electrode": frozenset({"reference_electrode"}),
    "reaction set": frozenset({"components"}),
    "experiment": frozenset({"results"}),
    "hardening": frozenset({"alloy", "yield_stress"}),
    "medium": frozenset({"title", "temperature"}),
    "scene": frozenset({"immersion"}),
}
"""Kind -> keys at the top of every file of that kind; the first whose keys are all there counts."""
HOW_GIVEN = {"scene": "; a scene stands alone: perilife run {}"}
"""Kind -> what is said of a file that no option of an alloy, a medium, ... takes."""


def kind_of(entries: Mapping[str, object]) -> str:
    """The kind of a file with these entries, or nothing where they are of none."""
    return next((kind for kind, marks in MARKS.items() if marks <= set(entries)), "")


def refuse_another_kind(what: str, path: Path) -> Path:
    """Return the path of a file of one's own; ValueError where it plainly describes another thing.

    what : the kind that is wanted.  A file that cannot be read is left to whoever reads it.
    """
    try:
        kind = kind_of(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, RecursionError):
        return path
    if kind not in ("", what):
        raise ValueError(
            f"{what} is '{path}', which is the file of a{'n' * (kind[0] in 'aeiou')} {kind}"
            f"{HOW_GIVEN.get(kind, '').format(path)}"
        )
    return path


def refuse_unfilled(file: str, entries: Mapping[str, object]) -> None:
    """Refuse a file with entries that are FILL_IN, naming all of them at once."""
    left = list(_unfilled(entries))
    if left:
        several = len(left) > 1
        raise ValueError(
            f"{file}: {', '.join(left)} {'are' if several else 'is'} '{FILL_IN}'; "
            f"{'they are' if several else 'it is'} still to be filled in"
        )


def _unfilled(entries: Mapping[str, object], table: str = "") -> Iterator[str]:
    """Names of entries that are FILL_IN; of a quantity without value that of its table alone."""
    for key, entry in entries.items():
        if isinstance(entry, Mapping) and entry.get("value") == FILL_IN:
            yield f"{table}{key}"
        elif isinstance(entry, Mapping):
            yield from _unfilled(entry, f"{table}{key}.")
        elif entry == FILL_IN:
            yield f"{table}{key}"


def file_meant(name: str) -> str:
    """` (did you mean NAME.toml?)` where there is such a file, or what a file must end in."""
    path = Path(f"{name}.toml")
    if name and Path(name).is_file():
        return " (a file of one's own must end in .toml)"
    return f" (did you mean {path}?)" if path.is_file() else ""
