"""The rows of summary.csv as columns that show themselves."""

from __future__ import annotations

import io
from collections.abc import Sequence
from html import escape

from pipeline.record.summary import SummaryRow, columns, print_summary, shown


class Table(dict[str, list]):
    """Columns of summary.csv by name, each a list with a value per row.

    Prints as the command prints it and shows as a table in a notebook; `pandas.DataFrame(table)`
    takes it.
    """

    def __init__(self, rows: Sequence[SummaryRow]):
        named = columns(rows[0].load)
        super().__init__({name: [getattr(r, field) for r in rows] for field, name in named.items()})
        self._rows = tuple(rows)

    def __repr__(self) -> str:
        text = io.StringIO()
        print_summary(self._rows, text)
        return text.getvalue().rstrip()

    def _repr_html_(self) -> str:
        titles, cells = shown(self._rows)
        head = "".join(f"<th>{escape(title)}</th>" for title in titles)
        body = "".join(
            f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in cells
        )
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
