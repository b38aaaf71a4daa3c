"""What a TOML file describes, by the keys at its top: so that one kind given for another is named.

The files themselves do not say their kind; whatever reads one asks for the keys of its own.
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path

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
