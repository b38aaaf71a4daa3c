"""Cells that lock are named, with what that does to the peak; others are not."""

import pytest

from pipeline.stages.locking import locking
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
