"""The sources that data files name: reads a small, strict subset of BibTeX."""

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
"""The folder of the data files, in a checkout and in an installed copy alike."""

_ENTRY = re.compile(r"^@(\w+)\{([^,\s]+),\n(.*?)\n\}$", re.MULTILINE | re.DOTALL)
_FIELD = re.compile(r"^\s*(\w+)\s*=\s*\{(.*?)\},?$", re.MULTILINE)


@dataclass(frozen=True)
class Reference:
    """One source: its key and what is needed to find it (empty where not known)."""

    key: str
    author: str
    title: str
    published_in: str
    year: str
    doi: str = ""

    def __str__(self) -> str:
        doi = f"doi:{self.doi}" if self.doi else ""
        place = ", ".join(filter(None, (self.published_in, doi)))
        return ". ".join(filter(None, (f"{self.author} ({self.year})", self.title, place))) + "."


def read_references(path: Path) -> dict[str, Reference]:
    """Read a .bib file whose entries look like those of references.bib: one field a line.

    Raises FileNotFoundError, and ValueError for an entry without author, title or year, a key
    given twice, or an entry that cannot be read.
    """
    text = path.read_text(encoding="utf-8")
    references: dict[str, Reference] = {}
    for _, key, body in _ENTRY.findall(text):
        fields = {name.lower(): value for name, value in _FIELD.findall(body)}
        missing = [name for name in ("author", "title", "year") if not fields.get(name)]
        if missing:
            raise ValueError(f"{path.name}: entry '{key}' lacks {', '.join(missing)}")
        if key in references:
            raise ValueError(f"{path.name}: key '{key}' is given twice; each must be unique")
        where = [fields.get(name, "") for name in ("journal", "booktitle", "publisher", "school")]
        numbers = fields.get("volume", "")
        if fields.get("number"):
            numbers += f"({fields['number']})"
        if fields.get("pages"):
            numbers += f":{fields['pages'].replace('--', '–')}" if numbers else fields["pages"]
        published_in = " ".join(part for part in (*where, numbers) if part)
        authors = fields["author"].replace(" and ", "; ")
        doi = fields.get("doi", "")
        references[key] = Reference(
            key, authors, fields["title"], published_in, fields["year"], doi
        )
    if len(references) != len(re.findall(r"^@", text, re.MULTILINE)):
        raise ValueError(
            f"{path.name}: an entry cannot be read; write one field a line and the closing "
            "brace on a line of its own"
        )
    return references


@cache
def shipped_references() -> dict[str, Reference]:
    """Return every source that the shipped data files may name, by key."""
    return read_references(FOLDER / "references.bib")


def load_reference(key: str) -> Reference:
    """Return the source with this key. Raises ValueError for an unknown key."""
    try:
        return shipped_references()[key]
    except KeyError:
        raise ValueError(f"source '{key}' is not in references.bib") from None
