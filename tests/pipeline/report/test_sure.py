"""How a run was held and how sure it is: the same for a program, a terminal and the report."""

import json
from dataclasses import replace

import pytest

from pipeline.record.run_folder import RunFolder
from pipeline.record.run_results import read_run
from pipeline.record.summary import columns, read_summary
from pipeline.report import doubts
from pipeline.report.provenance import parameter_rows, to_be_listed
from pipeline.report.sure import NOT_MEASURED, how_sure, in_words
from pipeline.run import files, told
from pipeline.run import how_sure as of_folder
from pipeline.scene.resolution import RESOLUTIONS
from pipeline.scene.scene import ScrewGeometry
from pipeline.scene.screw import ScrewParameters
from tests.pipeline.report.run_folders import pin_mesh, scene_of, write_run

QUICK = RESOLUTIONS["quick"]


def read(path, **changes):
    """A run folder of the two shipped alloys, without its fields."""
    return read_run(write_run(path, scene_of(**changes), *pin_mesh(1e-3)), fields=False)


def test_a_program_is_told_what_the_report_says(tmp_path):
    run = read(tmp_path / "run", hold=["all"])
    folder = RunFolder(run.folder)
    rows = read_summary(folder.summary_file)
    found = json.loads(json.dumps(told(folder, run.scene, rows)))
    assert list(found["rows"][0]) == list(columns("axial").values())
    assert [way["name"] for way in found["held"]] == ["shank", "slot", "faces"]
    slot, faces = found["held"][1:]
    assert slot["part"] == "the slotted section"
    assert (slot["bottom_grip"], slot["top_grip"]) == pytest.approx((0.7e-3, 0.3e-3))
    assert slot["grips"].endswith("(bottom 700 µm, top 300 µm)")
    assert faces["grips"].endswith("(bottom its face, top its face)")
    error = {(r["quantity"], r["alloy"], r["hold"]): r for r in found["how_sure"]}
    assert len(error) == len(found["how_sure"]) == 2 + 2 * 3
    lost = error["volume_loss", "Mg-10Gd", None]
    assert lost["relative_error"] == QUICK.corrosion_error.of("Mg-10Gd")
    assert lost["source"].startswith("perilife study corrosion")
    assert error["strength_left", "Mg-5Gd", "slot"]["relative_error"] == pytest.approx(0.023)
    # the same numbers and lists as in the report
    said = doubts.error_estimate(run)
    for row in found["how_sure"]:
        assert f"{100 * row['relative_error']:.1f} %" in said
    assert found["doubts"] == doubts.checks(run)
    assumed = to_be_listed(parameter_rows(run.scene))
    assert [row["name"] for row in found["assumed"]] == [row.name for row in assumed]


def test_a_terminal_has_a_line_for_each_way_of_holding(tmp_path):
    run = read(tmp_path / "run", hold=["shank", "faces"])
    shank, sure, faces, unsure, left, loss = in_words(run)
    assert shank.startswith("shank: the shank, held at both ends")
    fast, slow = (f"{100 * QUICK.tensile_error.of(a):.1f} %" for a in ("Mg-5Gd", "Mg-10Gd"))
    assert f"within {fast} (Mg-5Gd), {slow} (Mg-10Gd) of its value" in sure
    assert "bottom its face" in faces and "65.3 % (Mg-10Gd)" in unsure
    assert unsure.endswith(
        "on the reference screw by cells of 33 µm at the faces in place of 50 µm"
    )
    assert left.startswith("strength left:") and "0.8 % (Mg-10Gd)" in loss


def test_a_run_and_a_report_end_alike_and_name_the_page(tmp_path):
    run = read(tmp_path / "run")
    folder = RunFolder(run.folder)
    assert of_folder(folder) == in_words(run)
    assert files(folder) == ["", f"table:  {folder.summary_file}"]
    folder.report_file.write_text("page")
    assert files(folder)[-1].startswith(f"report: {folder.report_file} (how sure")


def test_what_was_not_measured_borrows_no_error(tmp_path):
    pin = ScrewGeometry(ScrewParameters(thread="none"))
    run = read(tmp_path / "run", geometry=pin)
    assert {row.relative_error for row in how_sure(run)} == {None}
    assert sum(NOT_MEASURED in line for line in in_words(run)) == 2
    run.alloys[0].corrosion_numbers["sampling_error"] = 0.0032
    assert "volume loss: off by about 0.3 % (Mg-5Gd) of its value, found by" in in_words(run)[-1]
    own = how_sure(run)[0]
    assert (own.alloy, own.relative_error, own.measured_of) == ("Mg-5Gd", 0.0032, ())
    # nothing is lost of what was not immersed, and all of it left
    assert how_sure(read(tmp_path / "intact", weeks=("0w",))) == []


def test_an_alloy_of_ones_own_is_told_of_which_the_error_was_measured(tmp_path):
    run = read_run(write_run(tmp_path / "run", scene_of(("Mg-5Gd",)), *pin_mesh(1e-3)), False)
    mine = replace(run.scene, alloys=(replace(run.scene.alloys[0], name="mine"),))
    (line,) = [line for line in in_words(replace(run, scene=mine)) if "how sure" in line]
    assert "(mine) of its value, measured on the reference screw of Mg-5Gd and Mg-10Gd" in line
