"""Inverse design: the search on a curve that is known, refusals, and one real answer (slow)."""

from pathlib import Path

import pytest

from pipeline.campaigns.design import Candidate, Designer, Target, front
from pipeline.campaigns.varied import Choice, Range, changed, read_vary
from pipeline.cli import build_parser, main
from pipeline.record.summary import read_summary
from pipeline.scene.scene import SceneError
from tests.pipeline.calibration.test_calibrate import PIN

WEEK = 604800.0


class Known(Designer):
    """A designer whose share left is 1 - (0.5 mm / value)^2."""

    def __init__(self, target, options=None):
        super().__init__(options, target, Path("nowhere"))

    def evaluate(self, name, text, label):
        metres = 1e-6 * float(text.removesuffix("um"))
        share = 1 - (0.5e-3 / metres) ** 2
        self.tried[label] = Candidate(label, share, 1e8 * metres**2 * share, 0.1, Path(label))
        return self.tried[label]


def test_the_answer_keeps_the_target_and_a_hundredth_less_does_not():
    designer = Known(Target(12 * WEEK, share=0.8))
    found = designer.root(Range("diameter", 0.6e-3, 4e-3))
    exact = 0.5e-3 / 0.2**0.5
    value = float(found.label.split()[0]) * {"mm": 1e-3, "um": 1e-6}[found.label.split()[1]]
    assert found.share >= 0.8 and exact <= value <= 1.011 * exact
    assert len(designer.tried) < 12


def test_a_force_is_a_target_too():
    found = Known(Target(12 * WEEK, force=300.0)).root(Range("diameter", 0.6e-3, 4e-3))
    assert 300.0 <= found.peak < 310.0


def test_ranges_without_an_answer_are_refused_with_the_better_end():
    designer = Known(Target(12 * WEEK, share=0.8))
    with pytest.raises(SceneError, match="every value tried"):
        designer.root(Range("diameter", 2e-3, 4e-3))
    with pytest.raises(SceneError, match=r"the better one, 1 mm, keeps 75.0 %"):
        designer.root(Range("diameter", 0.6e-3, 1e-3))


def test_the_best_of_a_list_is_taken_and_named_where_none_will_do(monkeypatch):
    designer = Known(Target(12 * WEEK, share=0.8))
    shares = {"A": 0.7, "B": 0.9}
    monkeypatch.setattr(
        designer,
        "evaluate",
        lambda name, text, label: Candidate(label, shares[label], 1.0, 0.1, Path(label)),
    )
    assert designer.best(Choice("alloy", ("A", "B"))).label == "B"
    shares["B"] = 0.75
    with pytest.raises(SceneError, match="none of A, B keeps .*; the best, B, keeps 75.0 %"):
        designer.best(Choice("alloy", ("A", "B")))


def options_of(*more):
    arguments = ["design", "--alloy", "Mg-5Gd", "--at", "12w", "--strength-left", "0.8"]
    return build_parser().parse_args([*arguments, "--vary", "x=1", "--out", "o", *more])


def test_ranges_and_lists_are_read_and_change_their_option():
    assert read_vary("slot-width=0.2mm:0.3mm") == Range("slot_width", 2e-4, 3e-4)
    assert read_vary("coating-lifetime=1w:8w") == Range("coating_lifetime", WEEK, 8 * WEEK)
    assert read_vary("classes=0,3") == Choice("classes", ("0", "3"))
    options = options_of("--coating", "factor=0.1,lifetime=28d")
    assert changed(options, "classes", "3").classes == "3"
    assert changed(options, "alloy", "Mg-10Gd").alloy == ["Mg-10Gd"]
    text = changed(options, "coating_lifetime", "336h").coating
    assert text == "factor=0.1,lifetime=1209600.0s" and options.coating != text
    points = Range("coating_factor", 0.1, 0.5).points()
    assert points == ["0.1", "0.2", "0.3", "0.4", "0.5"]
    with pytest.raises(ValueError, match="needs --coating"):
        changed(options_of(), "coating_factor", "0.2")


def test_the_front_of_two_says_where_there_is_no_answer(tmp_path):
    """A share of 1 - (0.5 mm/d)^2 for what is asked: more with a longer screw."""
    wanted = {"3mm": 0.75, "4mm": 0.96, "5mm": 0.999}

    def make(options, folder):
        return Known(Target(12 * WEEK, share=wanted[options.length]))

    diameter, lengths = Range("diameter", 0.6e-3, 4e-3), Choice("length", tuple(wanted))
    rows = dict(front(make, options_of(), tmp_path, diameter, lengths))
    found = [float(rows[text].label.removesuffix("mm").strip()) for text in ("3mm", "4mm")]
    assert found == pytest.approx([1.0, 2.5], rel=0.011)
    assert "neither end" in rows["5mm"]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--strength-left", "0.8", "--vary", "colour=1mm:2mm"], "--vary is 'colour=1mm:2mm'"),
        (["--strength-left", "0.8", "--vary", "diameter=2mm"], "diameter=LOW:HIGH"),
        (["--strength-left", "0.8", "--vary", "alloy=Mg-5Gd"], "two different values"),
        (["--strength-left", "0.8", "--vary", "alloy=Mg-5Gd,Mg-6Gd"], "'Mg-6Gd' is unknown"),
        (["--strength-left", "0.8", "--vary", "coating-factor=0.1:0.5"], "needs --coating"),
        (
            ["--strength-left", "0.8", *(3 * ["--vary", "diameter=2mm:3mm"])],
            "give one or two",
        ),
        (["--strength-left", "0.8", "--vary", "diameter=3mm:2mm"], "must rise"),
        (["--strength-left", "1.8", "--vary", "diameter=2mm:3mm"], "--strength-left is 1.8"),
        (["--vary", "diameter=2mm:3mm"], "either --strength-left or --force"),
        (["--force", "much", "--vary", "diameter=2mm:3mm"], "--force is 'much'"),
        (
            ["--strength-left", "0.8", "--probability", "1", "--vary", "length=3mm:4mm"],
            "--probability is 1",
        ),
        (
            ["--strength-left", "0.8", "--probability", "0.9", "--vary", "length=3mm:4mm"],
            "has no posterior of Mg-5Gd",
        ),
    ],
)
def test_the_command_refuses_in_one_sentence(more, words, tmp_path, capsys):
    out = tmp_path / "design"
    arguments = ["design", "--alloy", "Mg-5Gd", "--at", "12w", *more, "--out", str(out)]
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1 and not out.exists()


@pytest.mark.slow
def test_a_thicker_pin_keeps_more_and_the_answer_is_a_run(tmp_path, capsys):
    out = tmp_path / "design"
    arguments = [
        "design",
        "--alloy",
        "Mg-5Gd",
        "--at",
        "8w",
        "--strength-left",
        "0.85",
        *PIN,
        "--quiet",
    ]
    arguments += [
        "--spacing",
        "150um",
        "--horizon",
        "150um",
        "--mesh-size",
        "0.6mm",
        "--vary",
        "diameter=1.6mm:3mm",
        "--out",
        str(out),
    ]
    assert main(arguments) == 0
    lines = capsys.readouterr().out.strip().splitlines()
    tried = sorted(
        (float(line.split()[1]), float(line.split(":")[1].split()[0])) for line in lines[:-1]
    )
    table = (out / "design.csv").read_text().splitlines()
    assert table[0] == "diameter,strength_ratio,peak_N_or_N_m,volume_loss,run"
    assert len(table) == len(lines)  # every value tried, and a head for the answer
    shares = [share for _, share in tried]
    assert shares == sorted(shares) and min(shares) < 85 <= max(shares)
    folder = Path(lines[-1].split("its run is in ")[1])
    assert 0.85 <= read_summary(folder / "summary.csv")[-1].strength_ratio < 0.86


@pytest.mark.slow
def test_a_coating_is_searched_by_one_curve_and_verified_by_a_run(tmp_path, capsys):
    out = tmp_path / "design"
    arguments = ["design", "--alloy", "Mg-5Gd", "--at", "12w", "--strength-left", "0.85", *PIN]
    arguments += ["--spacing", "150um", "--horizon", "150um", "--mesh-size", "0.6mm", "--quiet"]
    arguments += ["--coating", "factor=0.1,lifetime=12w", "--vary", "coating-factor=0:1"]
    assert main([*arguments, "--out", str(out)]) == 0
    lines = capsys.readouterr().out.strip().splitlines()
    full = next(line for line in lines if line.startswith("the full run"))
    assert abs(float(full.split(", ")[-1].split()[0])) < 1.0  # %-points from the curve
    assert 84 < float(full.split(":")[1].split()[0]) < 86.5
    factor = float(lines[-1].split()[2])
    assert 0.02 < factor < 0.9
    # one run, and a strength curve of a few tests
    assert [p.name for p in out.iterdir() if p.name.startswith("coating")] == [
        f"coating_factor-{factor:g}"
    ]
