"""Two media: one l or two, and the ratio of their rates over time."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.calibration.calibrate import calibrate
from pipeline.calibration.fit import CalibrationError, Measurements, fit
from pipeline.calibration.identifiability import of_fit
from pipeline.calibration.media import SHARED, compare
from pipeline.calibration.models import Implant, ReducedModel, constants, march
from pipeline.calibration.posterior import gaussian
from pipeline.cli import main
from pipeline.scene.resolve import resolve_scene
from tests.pipeline.calibration import synthetic
from tests.pipeline.calibration.test_calibrate import ACTING, COARSE, PIN, WEEK, WEEKS

TIMES = np.array([1.0, 4.0, 12.0]) * WEEK


@pytest.fixture(scope="module")
def pin():
    scene = resolve_scene(["Mg-5Gd"], ["8w"], **COARSE)
    implant = Implant(scene)
    return scene, implant, ReducedModel(scene, "Mg-5Gd", implant, ACTING)


def fitted(pin, faster, scale, seed):
    """A fit of synthetic data whose D_int and l are these times the published ones."""
    scene, implant, model = pin
    values = np.array([constants(scene, "Mg-5Gd")[name] for name in ACTING])
    logs = np.log(values * [faster, scale])
    noise = 0.002 * np.random.default_rng(seed).standard_normal(len(WEEKS))
    data = Measurements(WEEKS, model(WEEKS, logs)[0] + noise, np.full(len(WEEKS), 0.002))
    return calibrate(scene, "Mg-5Gd", data, implant=implant, starts=3), model(TIMES, logs)[0]


@pytest.fixture(scope="module")
def fits(pin):
    """Synthetic media: two that share l, and a third one."""
    return {
        "slow": fitted(pin, 0.3, 0.5, 1),
        "fast": fitted(pin, 1.0, 0.5, 2),
        "other": fitted(pin, 1.0, 1.0, 3),
    }


@pytest.mark.slow
def test_one_l_is_kept_and_narrows_what_both_say(fits):
    (slow, slow_loss), (fast, fast_loss) = fits["slow"], fits["fast"]
    found = compare({"slow": slow, "fast": fast}, TIMES)
    assert found.may_share and found.excess < 3.84 and found.shared.names[-1] == SHARED
    # the true ratio lies in the band, is no constant, and is not that of D_int
    low, middle, high = found.ratio
    truth = slow_loss / fast_loss
    assert np.all((low < truth) & (truth < high)) and np.ptp(truth) > 0.15
    assert np.all(np.abs(middle / truth - 1) < 0.05)
    assert found.speed[0] < 0.3 < found.speed[2] and truth[-1] > 1.5 * 0.3
    index = found.shared.names.index(SHARED)
    shared = np.sqrt(np.linalg.inv(found.shared.fisher())[index, index])
    assert shared < min(one.posterior.deviations()[1] for one in (slow, fast))


@pytest.mark.slow
def test_another_l_is_seen(fits):
    found = compare({"fast": fits["fast"][0], "other": fits["other"][0]}, TIMES)
    assert not found.may_share and found.probability < 1e-3
    assert "do not share l" in found.lines()[0]


def stand_in(faster, scale, seed, free=("interface_diffusivity", SHARED)):
    """A fit of a small synthetic implant, with the Gaussian of its optimum, as marches have it."""
    logs = synthetic.truth() + np.log([faster, scale])
    values = synthetic.model(WEEKS, logs)[0]
    values = values + 0.002 * np.random.default_rng(seed).standard_normal(len(WEEKS))
    parameters = [replace(p, name=n) for p, n in zip(synthetic.PARAMETERS, free, strict=True)]
    result = fit(
        synthetic.model, Measurements(WEEKS, values, np.full(len(WEEKS), 0.002)), parameters,
        starts=3,
    )  # fmt: skip
    sampled = gaussian(result, of_fit(result).covariance, 4000)
    return SimpleNamespace(result=result, model=synthetic.model, posterior=sampled)


def test_two_media_of_one_l_and_of_two():
    slow, fast, other = stand_in(0.3, 1.0, 1), stand_in(1.0, 1.0, 2), stand_in(1.0, 2.0, 3)
    alike, unlike = (compare({"slow": slow, "b": b}, TIMES) for b in (fast, other))
    assert alike.may_share and alike.excess < 3.84
    low, middle, high = alike.ratio
    truth = [synthetic.model(TIMES, synthetic.truth() + [d, 0])[0] for d in (np.log(0.3), 0.0)]
    truth = truth[0] / truth[1]
    assert np.all((low < truth) & (truth < high)) and np.all(np.abs(middle / truth - 1) < 0.05)
    assert alike.speed[0] < 0.3 < alike.speed[2] and truth[-1] > 1.3 * 0.3
    assert not unlike.may_share and "do not share l" in unlike.lines()[0]


def test_a_medium_without_l_and_one_medium_alone_are_refused():
    one = stand_in(1.0, 1.0, 1)
    without = stand_in(1.0, 1.0, 1, ("interface_diffusivity", "liquid_diffusivity"))
    with pytest.raises(CalibrationError, match="b: its data do not determine l"):
        compare({"a": one, "b": without}, TIMES)
    with pytest.raises(CalibrationError, match="must be two"):
        compare({"b": one}, TIMES)


@pytest.mark.slow
def test_the_command_writes_a_set_per_medium_and_the_ratio(tmp_path, capsys):
    files = []
    for name, factor in (("in-vitro", 1.0), ("in-vivo", 1.3)):
        path = tmp_path / f"{name}.csv"
        rows = zip((1, 2, 3, 4, 8), (3.4, 4.6, 6.4, 7.2, 9.9), strict=True)
        lines = [f"{week}, {factor * loss:.3f}, 0.5" for week, loss in rows]
        head = "immersion time [w], volume loss [%], standard deviation [%]"
        path.write_text("\n".join([head, *lines]) + "\n")
        files.append(f"{name}={path}")
    out = tmp_path / "fits"
    arguments = ["calibrate", "--alloy", "Mg-5Gd", *PIN, "--out", str(out), "--media"]
    assert main([*arguments, *files]) == 0
    said = capsys.readouterr().out
    assert "--- in-vivo" in said and "rate in-vitro over in-vivo, 5%, 50%, 95%" in said
    for name in ("in-vitro", "in-vivo"):
        assert (out / name / "parameters.toml").is_file()
    content = json.loads((out / "media.json").read_text())
    assert 0 < content["probability_of_as_much_if_shared"] <= 1
    rows = (out / "ratio.csv").read_text().splitlines()
    assert rows[0] == "immersion_days,rate_ratio_5,rate_ratio_50,rate_ratio_95"
    assert 0.6 < float(rows[-1].split(",")[2]) < 0.95  # 1/1.3 in the data


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--media", "a=x.csv"], "--media names 1 media; they must be two"),
        (["--media", "a", "b"], "'a' is not understood"),
        (["--media", "a=x.csv", "b=y.csv", "--volume-loss", "Mg-5Gd=z.csv"], "exclude each other"),
    ],
)
def test_the_command_refuses_in_one_sentence(more, words, tmp_path, capsys):
    arguments = ["calibrate", "--alloy", "Mg-5Gd", "--out", str(tmp_path / "out"), *more]
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("alloy", "marched", "fine"),
    [("Mg-5Gd", (0.201, 0.493), (0.212, 0.508)), ("Mg-10Gd", (0.212, 0.448), (0.220, 0.455))],
)
def test_the_published_ratios_are_those_of_the_losses_and_no_constants(alloy, marched, fine):
    """Table 5.5 after 7 and 100 days; "0.5 and 0.46" are printed, and follow from no diffusivities.

    The lattice's error of the ratio is that of the faster medium; on 40 um it is 0.508 and 0.456.
    """
    times = 86400.0 * np.array([7.0, 100.0])
    marches, reduced = [], {100e-6: [], 50e-6: []}
    for name in ("table-5.5-in-vitro", "table-5.5-in-vivo"):
        for spacing, losses in reduced.items():
            scene = resolve_scene(
                [alloy], ["100d"], parameter_set=name, spacing=spacing, corrosion={"classes": 0}
            )
            if spacing == 100e-6:
                marches.append(march(scene.to_json(), alloy, times.tolist()))
            model = ReducedModel(scene, alloy, Implant(scene), ACTING)
            logs = np.log([constants(scene, alloy)[each] for each in ACTING])
            losses.append(model(times, logs)[0])
    slow, fast = np.array(marches)
    assert slow / fast == pytest.approx(marched, abs=0.001)
    ratios = {spacing: slow / fast for spacing, (slow, fast) in reduced.items()}
    # the liquid hardly counts: measured 0.0005 of the ratio
    assert ratios[100e-6] == pytest.approx(slow / fast, abs=0.001)
    assert ratios[50e-6] == pytest.approx(fine, abs=0.001)
    assert ratios[50e-6][1] == pytest.approx({"Mg-5Gd": 0.503, "Mg-10Gd": 0.451}[alloy], abs=0.01)
