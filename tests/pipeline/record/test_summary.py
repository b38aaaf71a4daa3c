"""The table of a run comes back from its file, degradation rates included."""

import io

import pytest

from pipeline.record.bands import BandRow, print_bands
from pipeline.record.summary import SummaryRow, print_summary, read_summary, write_summary


def test_rows_come_back_with_and_without_a_degradation_rate(tmp_path):
    rows = [
        SummaryRow("A", "shank", 0.0, 0.0, 0.0, 452.0, 1.0, 0.1, "completed"),
        SummaryRow("A", "shank", 56.0, 0.15, 0.14, 379.0, 0.84, 0.1, "completed", "axial", 0.2184),
    ]
    write_summary(tmp_path / "summary.csv", rows)
    header, first, _ = (tmp_path / "summary.csv").read_text().splitlines()
    assert header.endswith("status,degradation_rate_mm_per_year") and first.endswith("completed,")
    assert read_summary(tmp_path / "summary.csv") == rows


def test_printed_tables_keep_the_units_of_their_columns(capsys):
    row = SummaryRow("A", "shank", 56.0, 0.15, 0.14, 379.0, 0.84, 0.1, "completed", "axial", 0.2)
    print_summary([row])
    said = capsys.readouterr().out
    assert "[d]" in said and "[N]" in said and "[%]" in said
    three = (0.1, 0.2, 0.3)
    print_bands([BandRow("A", "shank", 84.0, three, three, three, 200, 0.004)])
    said = capsys.readouterr().out
    assert "[d]" in said and "[mm/year]" in said and "[%]" in said


def test_eighty_columns_hold_the_table(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("COLUMNS", "80")
    row = SummaryRow("Mg-10Gd", "shank", 168.0, 0.1359, 0.13, 1487.0, 0.892, 0.1, "completed")
    print_summary([row], said := Terminal())
    cells = "Mg-10Gd shank 168 13.59 1487.0 89.2 10.00 completed"
    assert cells.split() in [line.split() for line in said.getvalue().splitlines()]
    assert "…" not in said.getvalue()


def test_a_table_with_other_columns_is_refused(tmp_path):
    (tmp_path / "summary.csv").write_text("alloy,weeks\nA,3\n")
    with pytest.raises(ValueError, match="columns of"):
        read_summary(tmp_path / "summary.csv")
