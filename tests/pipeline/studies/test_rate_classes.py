"""The study of rate classes: its limits, medians and tables, with marches of known error."""

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.studies import rate_classes as study

LIMIT = np.array([0.05, 0.11, 0.15])


def fake(monkeypatch, clean: bool) -> None:
    """Marches whose error is 0.02 / m by nodes, 0.04 / m^2 with classes; positions add 1e-4."""

    class Case(SimpleNamespace):
        def scene(self, ratio):
            return None

        def exact(self):
            return LIMIT

    def march(case, ratio, shift, classes, clean, kept):
        error = 0.04 / ratio**2 if classes else 0.02 / ratio
        losses = LIMIT * (1 + error + 1e-4 * round(float(shift[0])))
        return study._March(None, losses, 0.005 if classes else None, 3.0, 2.0)

    monkeypatch.setattr(study, "Cases", lambda alloy, solid: Case(solid=None))
    monkeypatch.setattr(study, "_march", march)
    omission = SimpleNamespace(name="liquid", applied=clean)
    monkeypatch.setattr(study, "plan_omissions", lambda *a: [omission])
    row = study.StepRow("A", 0.1, 20, 1e-3, 2.0)
    monkeypatch.setattr(study, "_steps", lambda *a: [row])


@pytest.mark.parametrize("clean", [True, False])
def test_errors_are_medians_against_the_limit(monkeypatch, capsys, clean):
    fake(monkeypatch, clean)
    lattices, steps = study.study_rate_classes(["A"], print, {2: 5, 3: 1, 4: 1})
    errors = {(row.ratio, row.classes): row.error for row in lattices}
    for ratio in (2, 3, 4):
        assert errors[ratio, 3] == pytest.approx(0.04 / ratio**2, abs=4e-4)
        assert errors[ratio, 0] == pytest.approx(0.02 / ratio, abs=4e-4)
    spread = {row.ratio: row.spread for row in lattices if row.classes}
    assert 0 < spread[2] < 2e-4 and spread[3] == 0
    assert len(steps) == 1 and "δ/4, 3 rate classes: error 0.2" in capsys.readouterr().out


def test_tables(monkeypatch, capsys):
    fake(monkeypatch, True)
    study.print_rate_classes(["A"], {2: 1, 4: 1})
    printed = capsys.readouterr().out
    assert "| A | one per node | 2 | 1 | 1.0" in printed and "| A | 3 | 4 | 1 | 0.2" in printed
    assert "| A | 0.1 | 20 | 0.10 % | 2.0 s |" in printed
