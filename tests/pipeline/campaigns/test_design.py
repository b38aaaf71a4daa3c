"""Inverse design: the search on a curve that is known, refusals, and one real answer (slow)."""

from pathlib import Path

import pytest

from pipeline.campaigns.design import Candidate, Designer, Target
from pipeline.cli import main
from pipeline.record.summary import read_summary
from pipeline.scene.scene import SceneError
from tests.pipeline.calibration.test_calibrate import PIN

WEEK = 604800.0


class Known(Designer):
    """A designer whose share left is 1 - (0.5 mm / value)^2."""

    def __init__(self, target):
        super().__init__(None, target, Path("nowhere"))

    def evaluate(self, name, value, label):
        metres = 1e-6 * float(value.removesuffix("um"))
        share = 1 - (0.5e-3 / metres) ** 2
        self.tried[label] = Candidate(label, share, 1e8 * metres**2 * share, 0.1, Path(label))
        return self.tried[label]


def test_the_answer_keeps_the_target_and_a_hundredth_less_does_not():
    designer = Known(Target(12 * WEEK, share=0.8))
    found = designer.length("diameter", 0.6e-3, 4e-3)
    exact = 0.5e-3 / 0.2**0.5
    value = float(found.label.split()[0]) * {"mm": 1e-3, "um": 1e-6}[found.label.split()[1]]
    assert found.share >= 0.8 and exact <= value <= 1.011 * exact
    assert len(designer.tried) < 12


def test_a_force_is_a_target_too():
    found = Known(Target(12 * WEEK, force=300.0)).length("diameter", 0.6e-3, 4e-3)
    assert 300.0 <= found.peak < 310.0


def test_ranges_without_an_answer_are_refused_with_the_better_end():
    designer = Known(Target(12 * WEEK, share=0.8))
    with pytest.raises(SceneError, match="every value tried"):
        designer.length("diameter", 2e-3, 4e-3)
    with pytest.raises(SceneError, match=r"the better one, 1 mm, keeps 75.0 %"):
        designer.length("diameter", 0.6e-3, 1e-3)


def test_alloys_are_ranked(monkeypatch):
    designer = Known(Target(12 * WEEK, share=0.8))
    shares = {"A": 0.7, "B": 0.9}
    monkeypatch.setattr(
        designer,
        "evaluate",
        lambda name, value, label: Candidate(label, shares[label], 1.0, 0.1, Path(label)),
    )
    assert [c.label for c in designer.alloys(["A", "B"])] == ["B", "A"]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--strength-left", "0.8", "--vary", "colour=1mm:2mm"], "--vary is 'colour=1mm:2mm'"),
        (["--strength-left", "0.8", "--vary", "diameter=2mm"], "diameter=LOW:HIGH"),
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
        "0.82",
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
    shares = [share for _, share in tried]
    assert shares == sorted(shares) and min(shares) < 82 <= max(shares)
    folder = Path(lines[-1].split("its run is in ")[1])
    assert 0.82 <= read_summary(folder / "summary.csv")[-1].strength_ratio < 0.835
