"""Surrogates of marches: on functions that are known, and (slow) in a run whose liquid counts."""

import numpy as np
import pytest

from pipeline.calibration.surrogate import Box
from pipeline.campaigns.banded import Samples
from pipeline.campaigns.surrogate_bands import FIRST, Learned, MarchedSamples, _slope
from pipeline.cli import main
from pipeline.record.bands import read_bands
from pipeline.record.doubts import read_doubts
from pipeline.record.progress import Progress
from pipeline.record.summary import read_summary
from pipeline.scene.scene import SceneError
from tests.pipeline.calibration.test_calibrate import PIN

pytest.importorskip("sklearn")
BOX = Box(("a", "b"), (1e-15, 0.1), (1e-13, 0.4))


def losses_of(point):
    """Two values as different as an early and a late loss."""
    x, y = np.log10(point[0]) + 14.0, point[1]
    return np.array([0.05 * np.exp(x) * y, 0.3 * np.tanh(2.0 * x + y)])


def test_points_are_added_until_every_value_is_known():
    learned = Learned(BOX, losses_of)
    first = learned.worst.max()
    learned.learn(20, 0.01)
    assert FIRST < len(learned.points) <= 20 and learned.worst.max() <= 0.01 < first
    points = np.exp(np.random.default_rng(0).uniform(np.log(BOX.lower), np.log(BOX.upper), (50, 2)))
    truth = np.array([losses_of(point) for point in points])
    assert np.abs(learned(points) - truth).max() < 0.02
    # what is good enough is not learned further
    before = len(learned.points)
    learned.learn(40, 0.02)
    assert len(learned.points) == before


def test_a_surrogate_that_errs_by_more_than_three_hundredths_is_refused():
    noise = np.random.default_rng(1)
    marched = object.__new__(MarchedSamples)
    marched.alloy, marched.progress = "Mg-10Gd", Progress()
    points = np.exp(noise.uniform(np.log(BOX.lower), np.log(BOX.upper), (30, 2)))
    marched.samples, marched.most, marched.tolerance = Samples(BOX.names, points), FIRST, 0.01
    marched.evaluate = lambda point: noise.uniform(size=2)
    with pytest.raises(SceneError, match=r"it must be at most 0.03, with more --surrogate"):
        marched.banded(None)


def test_the_slope_is_that_of_the_samples():
    losses = np.linspace(0.1, 0.2, 20)
    assert _slope(losses, 1 - 1.1 * losses)(0.15) == pytest.approx(-1.1)
    assert _slope(np.ones(5), np.ones(5))(1.0) == 0.0


@pytest.mark.parametrize("count", ["7", "401"])
def test_a_count_out_of_range_is_refused_before_anything_is_made(count, tmp_path, capsys):
    run = ["run", "--alloy", "Mg-10Gd", "--immersion", "4w", "--samples", "40"]
    assert main([*run, "--surrogate", count, "--out", str(tmp_path / "run")]) == 2
    assert f"--surrogate is {count}; it must be from 8 to 400" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_run_whose_liquid_counts_has_bands_that_hold_its_own_values(tmp_path, capsys):
    file, fit, out = tmp_path / "data.csv", tmp_path / "fit", tmp_path / "run"
    rows = "1, 2.5, 0.5\n2, 3.9, 0.5\n3, 5.1, 0.5\n4, 6.0, 0.5\n8, 8.4, 0.5"
    file.write_text(f"immersion time [w], volume loss [%], standard deviation [%]\n{rows}\n")
    alloy = ["--alloy", "Mg-10Gd", *PIN]
    data = ["--volume-loss", f"Mg-10Gd={file}", "--keep", "liquid"]
    assert main(["calibrate", *alloy, *data, "--out", str(fit)]) == 0
    run = ["run", *alloy, "--immersion", "4w", "12w", "--keep", "liquid", "--mesh-size", "0.8mm"]
    run += ["--parameters", str(fit / "parameters.toml"), "--samples", "60", "--quiet"]
    assert main([*run, "--out", str(tmp_path / "other")]) == 2
    assert "without --surrogate" in capsys.readouterr().err
    assert main([*run, "--surrogate", "12", "--out", str(out)]) == 0
    rows, bands = read_summary(out / "summary.csv"), read_bands(out / "bands.csv")
    for row, band in zip(rows, bands, strict=True):
        low, middle, high = band.volume_loss
        assert low < row.volume_loss < high and abs(middle / row.volume_loss - 1) < 0.2
        low, _, high = band.strength_ratio
        assert low < row.strength_ratio < high and band.strength_curve_error < 0.03
    one = read_doubts(out / "doubts.json")[0]
    assert "surrogate" in {source.name for source in one.sources} and one.slope < 0
