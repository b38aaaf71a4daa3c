"""The loss in a later scan beside the computed one: shares, places, what is refused."""

import csv

import numpy as np
import pytest

from pipeline.cli import main
from pipeline.geometry.scans import level_surface
from pipeline.geometry.surface import Solid
from pipeline.geometry.voxel_mask import VoxelMask, voxel_fraction
from pipeline.measured.command import _lie_in_words
from pipeline.measured.loss import loss_by_place
from tests.pipeline.command_line import refused
from tests.pipeline.geometry.scans import ball, write_mha

VOXEL, RADIUS, LEFT = 20e-6, 0.6e-3, 0.5e-3
SPACING, SHAPE = 60e-6, (27, 27, 27)


def ball_mask(radius: float, shift: float = 0.0) -> VoxelMask:
    """A ball about (1, 1, 1) mm, shifted along x."""
    metal = ball(radius, VOXEL)
    corner = 1e-3 - VOXEL * np.array(metal.shape) / 2 + [shift, 0.0, 0.0]
    return VoxelMask(metal, tuple(corner.tolist()), (VOXEL,) * 3)


def intact() -> Solid:
    """The ball before corrosion."""
    mask = ball_mask(RADIUS)
    points, triangles, _ = level_surface(mask, "ball")
    box = tuple(points.min(axis=0).tolist()), tuple(points.max(axis=0).tolist())
    return Solid("ball", 0.0, 0.0, 0.0, 0.0, box, 0.0, points, triangles, voxels=mask)


def result(left: VoxelMask) -> dict:
    """What a march would store whose computed metal is exactly that of a mask."""
    origin = np.full(3, 1e-3 - 13 * SPACING)
    before = voxel_fraction(ball_mask(RADIUS), origin, SPACING, SHAPE)
    after = voxel_fraction(left, origin, SPACING, SHAPE)
    share = np.divide(after, before, out=np.zeros(SHAPE), where=before > 0)
    return {
        "lattice/origin": origin,
        "lattice/spacing": np.full(3, SPACING),
        "metal": before > 0,
        "capacity": before,
        "solid_concentration": 5e4,
        "concentration": np.stack([np.full(SHAPE, 5e4), 5e4 * share]),
    }


def test_a_result_that_is_right_agrees_at_every_place() -> None:
    left = ball_mask(LEFT)
    found = loss_by_place(intact(), left, result(left), 1, 200e-6, "scan")
    rows = {name: values for name, *values in found.table()}
    lost = 1 - left.volume / ball_mask(RADIUS).volume  # 42 %, as of balls
    assert lost == pytest.approx(1 - (LEFT / RADIUS) ** 3, abs=0.01)
    assert rows["whole"][1:] == pytest.approx([lost, lost], rel=1e-5)
    assert len(rows) == 1 + 8 + 3
    for measured, computed in (values[1:] for values in rows.values()):
        assert measured == pytest.approx(computed, abs=1e-5)
    assert rows["depth 0 to 100 um"][1] > 0.6 > 0.2 > rows["depth above 200 um"][1]
    assert found.disagreement() < 1e-6
    metal = sum(values[0] for name, values in rows.items() if name.startswith("z "))
    assert metal == pytest.approx(rows["whole"][0], rel=1e-9)


def test_a_result_that_is_wrong_is_shown_where_it_is() -> None:
    # computed: nothing has happened; measured: the ball is smaller
    found = loss_by_place(intact(), ball_mask(LEFT), result(ball_mask(RADIUS)), 1, 200e-6, "scan")
    rows = {name: values for name, *values in found.table()}
    assert rows["whole"][2] == pytest.approx(0.0, abs=1e-6) and rows["whole"][1] > 0.4
    assert found.disagreement() > 0.2
    difference = found.difference()
    assert difference[13, 13, 13] < 0.01 and difference.max() > 0.3
    assert found.depth[np.unravel_index(difference.argmax(), SHAPE)] < 200e-6


@pytest.mark.parametrize("moved", [0.0, 20e-6, 50e-6, -70e-6])
def test_a_scan_that_was_moved_is_noticed(moved) -> None:
    """Both balls have lost metal, not equally much; the lattice has 60 um."""
    computed, scan = result(ball_mask(LEFT)), ball_mask(LEFT + 40e-6, moved)
    shift = loss_by_place(intact(), scan, computed, 1, 200e-6, "scan").shift()
    assert shift == pytest.approx([-moved, 0.0, 0.0], abs=SPACING / 6)
    words = _lie_in_words(shift, np.full(3, SPACING))
    assert ("if it were moved" in words) == (abs(moved) > 15e-6)


def test_a_scan_beside_the_solid_is_refused() -> None:
    with pytest.raises(ValueError, match="scan has .* of its metal where the intact solid has"):
        loss_by_place(
            intact(), ball_mask(RADIUS, 0.4e-3), result(ball_mask(LEFT)), 1, 200e-6, "scan"
        )


@pytest.mark.slow
def test_the_command_writes_table_and_field(tmp_path, capsys) -> None:
    values = np.where(ball(RADIUS, 40e-6), 200, 20).astype(np.uint8)
    write_mha(tmp_path / "before.mha", values, 40e-6)
    counts = np.subtract(values.shape, ball(LEFT, 40e-6).shape)
    around = [(n // 2, n - n // 2) for n in counts]
    after = np.where(np.pad(ball(LEFT, 40e-6), around), 200, 20).astype(np.uint8)
    write_mha(tmp_path / "after.mha", after, 40e-6)
    out = str(tmp_path / "run")
    scene = ["--alloy", "Mg-5Gd", "--immersion", "8w", "--image", str(tmp_path / "before.mha")]
    assert main(["geometry", *scene, "--threshold", "100", "--out", out, "--quiet"]) == 0
    scan = ["--image", str(tmp_path / "after.mha"), "--threshold", "100"]
    refused_so_far = ["compare-image", out, *scan, "--time", "8w"]
    capsys.readouterr()
    refused(capsys, refused_so_far, "corrode", "not complete")
    assert main(["corrode", "--out", out, "--quiet"]) == 0
    capsys.readouterr()
    refused(capsys, ["compare-image", out, *scan, "--time", "7w"], "time '7w'", "0w, 8w")
    refused(capsys, ["compare-image", out, "--time", "8w"], "--image")
    assert main(["compare-image", out, *scan, "--time", "8w"]) == 0
    assert "root mean square" in capsys.readouterr().out
    with open(tmp_path / "run/measured/loss.csv", encoding="utf-8") as file:
        rows = {row["place"]: row for row in csv.DictReader(file)}
    measured = float(rows["whole"]["measured_loss"])
    assert measured == pytest.approx(1 - (after > 20).sum() / (values > 20).sum(), abs=1e-6)
    import pyvista

    field = pyvista.read(tmp_path / "run/measured/loss.vti")
    cell = np.prod(field.spacing)
    total = field["metal_share_measured"].sum() * cell
    assert total == pytest.approx((after > 20).sum() * 40e-6**3, rel=1e-5)
    (history,) = (tmp_path / "run").rglob("history.csv")
    with open(history, encoding="utf-8") as file:
        last = list(csv.DictReader(file))[-1]
    computed = float(rows["whole"]["computed_loss"])
    assert computed == pytest.approx(float(last["volume_loss"]), rel=1e-4)
