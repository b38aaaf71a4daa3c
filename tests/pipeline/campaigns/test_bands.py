"""Bands of a run: what they need, and what they are on a coarse pin (slow: mechanical tests)."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from peri.engine.omission import Omission
from peri.omissions.names import LIQUID
from pipeline.calibration.models import Implant, ReducedModel
from pipeline.campaigns import bands, strength
from pipeline.campaigns.banded import Samples, samples_of
from pipeline.campaigns.strength import CurveTests, clean_at
from pipeline.cli import main
from pipeline.record.bands import BandRow, read_bands, write_bands
from pipeline.record.doubts import read_doubts
from pipeline.record.progress import Progress
from pipeline.record.summary import read_summary
from pipeline.scene.resolve import OWN_PARAMETERS, resolve_scene
from pipeline.scene.scene import SceneError
from pipeline.scene.units import ImmersionTime
from tests.pipeline.calibration.test_calibrate import COARSE, PIN


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """The parameter set of a coarse pin, from synthetic data slow enough for clean liquid."""
    folder = tmp_path_factory.mktemp("fit")
    file, out = folder / "synthetic.csv", folder / "set"
    columns = "immersion time [w], volume loss [%], standard deviation [%]"
    rows = "1, 3.4, 0.5\n2, 4.6, 0.5\n3, 6.4, 0.5\n4, 7.2, 0.5\n8, 9.9, 0.5"
    file.write_text(f"{columns}\n{rows}\n")
    data = f"Mg-5Gd={file}"
    arguments = ["calibrate", "--alloy", "Mg-5Gd", "--volume-loss", data, *PIN]
    assert main([*arguments, "--out", str(out)]) == 0
    return out / "parameters.toml"


def test_rows_come_back_from_their_file(tmp_path):
    rows = [
        BandRow(
            "Mg-5Gd", "slot", 84.0, (0.1, 0.2, 0.3), (0.02, 0.03, 0.04), (0.7, 0.8, 0.9), 200, 0.004
        )
    ]
    write_bands(tmp_path / "bands.csv", rows)
    assert read_bands(tmp_path / "bands.csv") == rows
    assert read_bands(tmp_path / "none.csv") == []
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match="columns of"):
        read_bands(tmp_path / "other.csv")


def test_samples_are_those_of_the_set(fitted):
    scene = resolve_scene(["Mg-5Gd"], ["8w"], parameter_set=str(fitted), **COARSE)
    drawn = samples_of(scene, "Mg-5Gd", 50)
    every = samples_of(scene, "Mg-5Gd", 400)
    assert drawn.values.shape == (50, 2) and every.values.shape == (400, 2)
    assert set(map(tuple, drawn.values)) <= set(map(tuple, every.values))
    spread = np.log(drawn.values).std(axis=0) / np.log(every.values).std(axis=0)
    np.testing.assert_allclose(spread, 1.0, atol=0.15)


def test_sets_without_samples_are_refused_before_anything_is_made(tmp_path, capsys):
    run = ["run", "--alloy", "Mg-5Gd", "--immersion", "8w", "--out", str(tmp_path / "run")]
    assert main([*run, "--samples", "100"]) == 2
    assert "has no posterior of Mg-5Gd" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    own = replace(resolve_scene(["Mg-5Gd"], ["8w"]), parameter_set=OWN_PARAMETERS)
    with pytest.raises(SceneError, match="without --parameters; it must go with a set"):
        samples_of(own, "Mg-5Gd", 100)


def test_more_samples_than_the_set_has_are_refused(fitted, tmp_path, capsys):
    run = ["run", "--alloy", "Mg-5Gd", "--immersion", "8w", *PIN, "--parameters", str(fitted)]
    assert main([*run, "--samples", "401", "--out", str(tmp_path / "run")]) == 2
    assert "must be 2 to 400" in capsys.readouterr().err
    run[run.index("8w")] = "0w"
    assert main([*run, "--samples", "40", "--out", str(tmp_path / "run")]) == 2
    assert "no immersion time is above 0" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_where_the_liquid_counts_the_curve_is_refused():
    scene = resolve_scene(["Mg-10Gd"], ["8w"], **COARSE)
    with pytest.raises(SceneError, match="no function of the volume loss alone"):
        clean_at(scene, "Mg-10Gd", Implant(scene), 56 * 86400.0)


def test_tests_of_a_curve_begin_at_the_volume_loss_asked_for(tmp_path):
    scene = resolve_scene(["Mg-5Gd"], ["8w"], **COARSE)
    implant = Implant(scene)
    tests = CurveTests(scene, "Mg-5Gd", implant, tmp_path)
    rate = np.log([scene.alloy("Mg-5Gd").corrosion.interface_diffusivity])
    model = ReducedModel(tests.scene, "Mg-5Gd", implant, ("interface_diffusivity",))
    for loss in (1e-4, 0.1, 0.3):
        time = tests.time_of(loss)
        assert model(np.array([time]), rate)[0][0] == pytest.approx(loss, rel=1e-9)
    with pytest.raises(SceneError, match="must be below"):
        tests.time_of(0.999)


def test_a_fixed_step_is_no_longer_than_the_times_of_a_search():
    scene = resolve_scene(["Mg-5Gd"], ["8w"], **{**COARSE, "corrosion": {"step": 86400.0}})
    assert scene.at(ImmersionTime("0w", 0.0), ImmersionTime("6h", 21600.0)).corrosion.step == 21600
    assert scene.at(ImmersionTime("2d", 172800.0)).corrosion.step == 86400
    assert scene.at(ImmersionTime("0w", 0.0)).corrosion.step == 86400


def test_the_fastest_and_the_farthest_of_the_samples_must_be_within_the_bound(monkeypatch):
    scene = resolve_scene(["Mg-5Gd"], ["8w"], **COARSE)
    implant, looked_at = Implant(scene), []
    # from fast and soon slow to slow and lasting: the first loses most at once, the last in the end
    rates = np.geomspace(6e-15, 5e-15, 80)
    values = np.stack([rates, np.geomspace(0.05, 1.0, 80)], axis=1)
    samples = Samples(("interface_diffusivity", "volume_loss_scale"), values)
    run = SimpleNamespace(scene=scene, progress=Progress())

    def within(beyond):
        def omission(changed, alloy, implant, times):
            rate = changed.alloy(alloy).corrosion.interface_diffusivity
            looked_at.append(int(np.argmin(np.abs(rates - rate))))
            return Omission(LIQUID, "so", 1e-4, looked_at[-1] not in beyond)

        monkeypatch.setattr(bands, "liquid_omission", omission)
        monkeypatch.setattr(strength, "liquid_omission", omission)
        return bands.BandedRun._losses(run, "Mg-5Gd", implant, samples)

    losses, mask = within(())
    assert looked_at == [0, 79] and mask.all() and np.argmax(losses[:, -1]) == 79
    losses, mask = within((0, 79))  # one at either end: two of 80 may go beyond
    assert np.flatnonzero(~mask).tolist() == [0, 79]
    with pytest.raises(SceneError, match="cannot be left out"):
        within((0, 1, 79))


@pytest.mark.slow
def test_bands_of_a_run_hold_its_own_values_and_are_kept(fitted, tmp_path, capsys):
    out = tmp_path / "run"
    run = ["run", "--alloy", "Mg-5Gd", "--immersion", "4w", "12w", *PIN, "--mesh-size", "0.6mm"]
    run += ["--hold", "shank", "faces", "--strength-tolerance", "0.02"]
    run += ["--parameters", str(fitted), "--samples", "60", "--out", str(out), "--quiet"]
    assert main(run) == 0
    assert "degradation rate" in capsys.readouterr().out
    rows, found = read_summary(out / "summary.csv"), read_bands(out / "bands.csv")
    cases = [("shank", 28.0), ("shank", 84.0), ("faces", 28.0), ("faces", 84.0)]
    assert [(band.hold, band.immersion_days) for band in found] == cases
    for row, band in zip(rows, found, strict=True):
        assert (row.hold, row.immersion_days) == (band.hold, band.immersion_days)
        low, middle, high = band.volume_loss
        assert low < row.volume_loss < high and abs(middle / row.volume_loss - 1) < 0.1
        # the rate is the loss over volume, surface and time: one factor for all three
        assert np.array(band.degradation_rate) / band.volume_loss == pytest.approx(
            row.degradation_rate / row.volume_loss
        )
        low, middle, high = band.strength_ratio
        assert low < row.strength_ratio < high
        # the run's own test lies on the curve of the others
        assert abs(middle - row.strength_ratio) < 0.05 and band.strength_curve_error <= 0.02
    # the ends give way sooner than the shank, and their band is its own
    assert found[3].strength_ratio[1] < 0.8 * found[1].strength_ratio[1]
    page = (out / "report.html").read_text()
    assert "5 to 95 %" in page and page.count("the layer at the end faces</td>") >= 2
    doubts = {one.hold: one for one in read_doubts(out / "doubts.json")}
    for hold, one in doubts.items():
        sources = {source.name: source for source in one.sources}
        own = next(row for row in rows if row.hold == hold and row.immersion_days == 84.0)
        assert one.strength_left == pytest.approx(own.strength_ratio) and one.slope < -0.5
        assert sources["hardening data"].low <= one.strength_left <= sources["hardening data"].high
        assert (
            sources["hardening data"].deviation > 0 and "horizon 125 um" in sources["horizon"].basis
        )
        assert all(0.3 < share <= 1 for share in one.constants.values())
        # a measurement at the end itself leaves least, and never more than there was
        left = [row.strength_left for row in one.after]
        assert max(left) <= one.now.strength_left and left[4] < 0.7 * left[0]
    assert set(doubts) == {"shank", "faces"} and "All doubts side by side" in page
    stamps = {p: p.stat().st_mtime_ns for p in Path(out).rglob("*.stage.json")}
    assert main([*run, "--resume"]) == 0
    assert {p: p.stat().st_mtime_ns for p in Path(out).rglob("*.stage.json")} == stamps
