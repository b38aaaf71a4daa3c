"""The study of the ions: what its columns and tables say, in their cheapest versions."""

import numpy as np
import pytest

from peri.engine.march.marching import TimeStepping
from pipeline.studies import ions, ions_published


@pytest.mark.slow
def test_joined_brucite_takes_what_sequential_splitting_loses() -> None:
    joined, short, long = ions.splitting_table((1000.0, 86400.0)).rows
    # Exact 0.8617 at spacing zero; with 80 nodes 0.864.
    assert joined.values["share"] == pytest.approx(0.8642, abs=1e-3) and joined.default
    # One after the other, a finite-difference model of its own: 1.6 % at 1000 s.
    assert short.values["share"] == pytest.approx(0.016, abs=0.0015)
    assert long.values["share"] == pytest.approx(short.values["share"] / 86.4, rel=1e-6)
    assert short.errors["share"] == short.values["share"] - joined.values["share"]


def test_forms_of_the_flux_agree_in_weak_fields_and_the_printed_one_halves_the_potential() -> None:
    table = ions.transport_tables()[0]
    rows = {row.choice: row for row in table.rows}
    assert [n for n, row in rows.items() if row.default] == ["sqra"]
    assert all(abs(row.errors["pH"]) < 1e-6 for row in rows.values())
    volts = {n: row.values["phi, mV"] for n, row in rows.items()}
    assert volts["as_published"] == pytest.approx(0.5 * volts["sg"], rel=1e-3)
    assert volts["sg"] > 0.5


def test_tables_are_read_as_markdown(tmp_path) -> None:
    table = ions.solubility_table()
    lines = ions.lines_of(table)
    assert lines[2].count("|") == lines[4].count("|") == 5
    assert "(default)" in lines[4] and "(default)" not in lines[5]
    ions.write_text(tmp_path / "out", ions.FILE, "# Title", "perilife study nnpp", "text")
    assert (tmp_path / "out" / ions.FILE).read_text().startswith("# Title\n\nWritten by `perilife")
    assert [p.name for p in (tmp_path / "out").iterdir()] == [ions.FILE]


@pytest.mark.slow
def test_published_features_of_saline_are_found_with_their_size() -> None:
    features = ions_published.saline_features(0.8e-3, 2 * 86400.0)
    lines = ions_published.lines_of(features)
    assert len(lines) == 2 + len(features) and "not decidable" not in "".join(lines)
    by_figure = {f.figure: f.found for f in features}
    assert by_figure["3.27"]["corrected"][0] and by_figure["3.28"]["corrected"][0]
    # With the printed conductivity the potential is next to none.
    printed, corrected = (
        float(by_figure["3.29"][name][1].split()[2]) for name in ions_published.SETS
    )
    assert 0 < printed < 0.05 * corrected


@pytest.mark.slow
def test_error_of_controlled_steps_falls_with_their_target() -> None:
    table = ions.step_table((86400.0,), (0.2, 0.05), 7 * 86400.0, say=lambda text: None)
    rows = {row.choice: row for row in table.rows}
    loose, tight = rows["SDIRK2, change 0.2"], rows["SDIRK2, change 0.05"]
    assert loose.values["steps"] < tight.values["steps"]
    # Measured 5.3e-4 and 1.4e-3: a week has few steps, whose growth is limited to twice.
    assert abs(tight.errors["V_L"]) < 0.5 * abs(loose.errors["V_L"]) < 0.005
    found = ions._march(TimeStepping(rate_change=0.2), 86400.0)
    assert found["apatite"] > 0 and np.isfinite(found["pH"])
