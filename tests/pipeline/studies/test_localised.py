"""Rows of the studies of localised corrosion, small."""

import numpy as np
import pytest

from pipeline.cli import main
from pipeline.scenes.couples import ae44_scene
from pipeline.studies.localised import COMSOL, couple_row, crevice_row
from tests.pipeline.command_line import refused


def test_seeds_ignite_where_they_should():
    """Right constants: between 2 and 3 mm; as on the printed lattice: between 0.3 and 0.5 mm."""
    assert crevice_row(3e-3, False, 2.5, nodes=64)[0] == "ignites"
    assert crevice_row(1e-3, False, 2.5, nodes=64)[0] == "dies out"
    row = crevice_row(0.5e-3, True, 2.5, nodes=64)
    assert row[0] == "ignites"
    assert float(row[4]) == pytest.approx(1.1, abs=0.2)  # the published site near the mouth, mm


@pytest.mark.slow
def test_a_couple_row_has_currents_and_depths():
    row, history = couple_row(ae44_scene("AA6063", 1e-3, 2e-3), 0.5)
    assert np.abs(history["imbalance"]).max() < 1e-12
    assert float(row[0]) == pytest.approx(0.0514, rel=0.02)
    joint, deepest, *along = (float(v) for v in row[2:8])
    assert 0.15 < joint <= deepest < COMSOL[1e-4]
    assert along == sorted(along, reverse=True)


def test_the_studies_are_listed(capsys):
    assert main(["study", "list"]) == 0
    printed = capsys.readouterr().out
    assert all(f"{name} " in printed for name in ("galvanic", "crevice", "pitting"))
    refused(capsys, ["study", "galvanik"], "did you mean galvanic")
