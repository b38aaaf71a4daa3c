"""The table of shares: what counts, what stands beside, and that a page shows it."""

import pytest

from pipeline.record.doubts import DOUBTS_FILE, HoldDoubts, Next, Source, write_doubts
from pipeline.record.run_results import read_run
from pipeline.report.shares import all_sources, share_tables
from pipeline.scene.resolution import RESOLUTIONS
from tests.pipeline.report.test_report import page_of, pin_mesh, scene_of, write_run


def doubts(alloy="Mg-5Gd", hold="shank"):
    """Doubts at 8 weeks whose samples and hardening carry the same."""
    sources = (
        Source("measurement and constants", 0.02, 0.4, 0.46, "200 samples"),
        Source("hardening data", 0.02, 0.39, 0.46, "another 46 %"),
        Source("horizon", None, None, None, "not computed"),
    )
    after = (Next(84.0, 0.005, 0.01),)
    constants = {"interface_diffusivity": 0.7, "volume_loss_scale": 0.9}
    now = Next(0.0, 0.01, 0.02)
    return HoldDoubts(
        alloy, hold, 56.0, 0.15, 0.43, -1.0, sources, constants, now, after, scatter=0.01
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("shares") / "run"
    scene = scene_of(alloys=["Mg-5Gd"], weeks=("0w", "8w"), hold=["shank", "faces"])
    write_run(path, scene, *pin_mesh())
    (path / "geometry" / "mesh.h5").unlink()  # no pictures, which take most of a report's time
    return path


def test_shares_add_up_without_the_grips_and_presets_join_in(run):
    results = read_run(run)
    sources = {source.name: source for source in all_sources(results, doubts())}
    assert list(sources)[-1] == "grips"
    # that share of 15 % of the volume, one to one, even within the bound
    lattice, error = sources["lattice and time steps"], RESOLUTIONS["quick"].corrosion_error
    assert lattice.deviation == pytest.approx(error.of("Mg-5Gd") * 0.15 / 3**0.5, rel=0.02)
    high = 0.43 * (1.0 + RESOLUTIONS["quick"].tensile_error.of("Mg-5Gd"))
    assert sources["mesh and increments"].high == pytest.approx(high)
    rows = {row["source"]: row for row in share_tables(results, [doubts()])[0]["rows"]}
    shares = [row["share"] for row in rows.values()]
    assert rows["grips"]["share"] == rows["horizon"]["share"] == "–"
    assert sum(float(s.split()[0]) for s in shares if s != "–") == pytest.approx(100, abs=2)
    assert rows["hardening data"]["share"] == rows["measurement and constants"]["share"]
    # both ways of holding have the same ratios in this run, so the grips change nothing
    assert rows["grips"]["deviation"] == "0.00"


def test_what_was_not_measured_is_not_counted(run, monkeypatch):
    results = read_run(run)
    faces = {source.name: source for source in all_sources(results, doubts(hold="faces"))}
    assert faces["mesh and increments"].deviation == pytest.approx(0.783 * 0.43 / 3**0.5)
    monkeypatch.setattr("pipeline.scene.errors.MEASURED", {})
    faces = {source.name: source for source in all_sources(results, doubts(hold="faces"))}
    assert faces["mesh and increments"].deviation is None
    assert "not measured" in faces["mesh and increments"].basis


def test_the_page_shows_the_table_and_what_to_measure_next(run):
    write_doubts(run / DOUBTS_FILE, [doubts(), doubts(hold="faces")])
    page, text = page_of(run)
    sure = page.sections["sure"]
    assert sure.count("What to measure next") == 2 and "12 weeks" in sure
    assert "the layer at the end faces: 43.0 % left after 8 weeks" in sure
    assert "<i>D</i><sub>int</sub> 70 %" in text
    assert page.open == []
