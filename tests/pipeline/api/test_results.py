"""The results of a run folder by name, from a synthetic run."""

import pytest

from pipeline import Results
from tests.pipeline.report.run_folders import RATIOS, pin_mesh, scene_of, write_run


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of both alloys in two ways of holding."""
    path = tmp_path_factory.mktemp("results") / "run"
    write_run(path, scene_of(hold=["shank", "faces"]), *pin_mesh())
    return path


def test_numbers_are_those_of_the_last_time_of_one_test(run) -> None:
    results = Results(run)
    assert results.alloys == ("Mg-5Gd", "Mg-10Gd") and results.holds == ("shank", "faces")
    with pytest.raises(ValueError, match=r"several alloys .* only\(alloy='Mg-5Gd'\)"):
        _ = results.strength_left
    with pytest.raises(ValueError, match=r"ways of holding .* only\(hold='shank'\)"):
        _ = results.only("Mg-5Gd").strength_left
    one = results.only("Mg-10Gd", "faces")
    assert one.strength_left == pytest.approx(RATIOS["Mg-10Gd"][-1])
    assert 0 < one.volume_loss < 1 and one.peak_force > 0
    with pytest.raises(AttributeError, match="no torque; see peak_force"):
        _ = one.peak_torque
    with pytest.raises(ValueError, match=r"did you mean Mg-5Gd"):
        results.only("mg5gd")


def test_the_table_has_the_columns_of_the_file_and_shows_itself(run) -> None:
    results = Results(run)
    table = results.table()
    lines = results._run_folder.summary_file.read_text().splitlines()
    assert list(table) == lines[0].split(",")
    assert {len(column) for column in table.values()} == {len(lines) - 1} == {16}
    assert table["alloy"][0] == "Mg-5Gd" and set(table["immersion_days"]) == {0, 28, 56, 168}
    assert "strength" in repr(table) and "168" in repr(table)
    page = results._repr_html_()
    assert page.count("<tr>") == 17 and "Mg-10Gd: the shank keeps" in page
    assert all(line in repr(results) for line in results.headlines())


def test_a_run_that_is_not_finished_is_refused(run, tmp_path) -> None:
    (tmp_path / "scene.json").write_bytes((run / "scene.json").read_bytes())
    with pytest.raises(ValueError, match=r"holds no summary.csv, so its run is not finished"):
        Results(tmp_path)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        Results(tmp_path / "absent")


def test_sources_are_those_of_the_numbers_used(run) -> None:
    sources = Results(run).sources
    assert "Hermann" in sources["hermann2024"]


def test_the_drawing_has_every_test(run) -> None:
    from matplotlib.colors import to_hex

    results = Results(run)
    left, right = results.plot().axes
    assert len(right.lines) == 2 * 2 * 4  # alloys, ways of holding, times
    assert {to_hex(line.get_color()) for line in right.lines} == {"#0072b2", "#d55e00"}
    assert [text.get_text() for text in left.get_legend().texts][:2] == ["Mg-5Gd", "Mg-10Gd"]
    assert results.only("Mg-5Gd", "shank").plot()._repr_png_().startswith(b"\x89PNG")
