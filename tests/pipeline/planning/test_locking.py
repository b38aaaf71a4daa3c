"""Cells that lock are named, with what that does to the peak; others are not."""

import re
from types import SimpleNamespace

import pytest

from pipeline.life_cycle import StagedRun
from pipeline.planning.locking import locking
from tests.pipeline.command_line import changed, scene_of


@pytest.mark.parametrize(
    ("element", "load", "what"),
    [
        ("P1", "axial", "constant volume"),
        ("P1-Fbar", "axial", None),
        ("P2", "axial", None),
        ("P1", "torsion", "shear"),
        ("P1-Fbar", "torsion", "shear"),
        ("P2", "torsion", None),
    ],
)
def test_what_locks_is_said(element, load, what):
    scene = scene_of(changed("--element", element, "--load", load))
    said = locking(scene.tensile)
    assert len(said) == (what is not None)
    assert what is None or (what in said[0][0] and "too large" in said[0][2])


def test_each_figure_says_of_what_it_is():
    ((_, _, said),) = locking(scene_of(changed("--element", "P1")).tensile)
    by_case = dict(
        re.findall(r"held by (?:its|the) (\w+), cells of [\d. to]+ mm, by ([\d to]+ %)", said)
    )
    assert by_case == {"shank": "13 to 16 %", "slot": "39 %"}  # as in pipeline/MEASURED.md


@pytest.mark.parametrize(("words", "notes"), [((), 0), (("--element", "P1"), 3)])
def test_a_run_says_so_of_cells_that_were_asked_for_alone(words, notes):
    """End faces are pulled with P1 cells as published, whatever the others have."""
    scene, said = scene_of(changed("--hold", "all", *words)), []
    assert "P1" in {hold.tensile.element for hold in scene.holds}
    run = SimpleNamespace(scene=scene, progress=SimpleNamespace(note=said.append))
    StagedRun._warn(run, [("Mg-5Gd", None, hold) for hold in scene.holds])
    assert len(said) == notes
