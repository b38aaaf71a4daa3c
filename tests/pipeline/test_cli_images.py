"""Solids from images on the command line: the whole way, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.cli import main
from pipeline.scene.image import ImageFile
from pipeline.scene.scene import scene_from_json
from pipeline.scene.screw import ScrewParameters
from tests.pipeline.command_line import refused, scene_of
from tests.pipeline.geometry.scans import write_mha, write_tiff

BASE = ["--alloy", "Mg-5Gd", "--immersion", "8w"]


def pin(voxel: float, radius: float = 0.6e-3, length: float = 3e-3) -> np.ndarray:
    """A cylinder along z with two voxels of nothing around it, 200 in 20."""
    counts = [int(2 * radius / voxel) + 6] * 2 + [int(length / voxel) + 4]
    x, y, z = (np.arange(n) + 0.5 - n / 2 for n in counts)
    round_ = np.hypot(x[:, None], y) < radius / voxel
    metal = round_[:, :, None] & (np.abs(z) < length / voxel / 2)
    return np.where(metal, 200, 20).astype(np.uint8)


def test_a_scene_from_an_image_comes_back_from_json_and_counts_by_content(tmp_path, capsys):
    write_tiff(tmp_path / "scan.tif", pin(100e-6))
    options = [*BASE, "--image", str(tmp_path / "scan.tif"), "--voxel", "100um", "50um", "0.2mm"]
    scene = scene_of([*options, "--threshold", "100", "--cap"])
    assert scene_from_json(json.loads(json.dumps(scene.to_json()))) == scene
    image = scene.geometry
    assert isinstance(image, ImageFile) and image.voxel == (100e-6, 50e-6, 200e-6)
    assert (image.threshold, image.label, image.cap) == (100.0, None, True)
    assert [hold.name for hold in scene_of([*options, "--label", "9", "--hold", "all"]).holds] == [
        "shank"
    ]
    (tmp_path / "scene.json").write_text(json.dumps(scene.to_json()))
    write_tiff(tmp_path / "scan.tif", pin(90e-6))
    assert scene_of([*options, "--threshold", "100"]).geometry.sha256 != image.sha256
    stored = ["--scene", str(tmp_path / "scene.json"), "--out", str(tmp_path / "run")]
    refused(capsys, ["run", *stored], "scan.tif'; it was changed after")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--voxel", "5um"], ["--voxel", "--image"]),
        (["--threshold", "5"], ["--threshold", "--image"]),
        (["--cap"], ["--cap", "--image"]),
        (["--image", "SCAN"], ["--threshold", "--label"]),
        (["--image", "SCAN", "--threshold", "1", "--label", "2"], ["--threshold", "--label"]),
        (["--image", "SCAN", "--label", "1", "--solid", "a.stl"], ["--solid", "--image"]),
        (["--image", "SCAN", "--label", "1", "--slot-depth", "1mm"], ["--slot-depth", "--image"]),
        (["--image", "SCAN", "--label", "1", "--unit", "um"], ["--unit", "--solid"]),
        (["--image", "SCAN", "--label", "1", "--voxel", "5"], ["voxel '5'", "100um"]),
        (["--image", "SCAN", "--label", "1", "--voxel", "0um"], ["voxel", "above 0"]),
        (["--image", "SCAN", "--label", "1", "--voxel", "-5um"], ["voxel '-5um' is negative"]),
        (["--image", "SCAN", "--label", "1", "--voxel", "5um", "5um"], ["one length, or three"]),
        (["--image", "SCAN", "--threshold", "nan"], ["threshold is nan", "finite"]),
        (["--image", "SCAN", "--label", "1.5"], ["--label", "1.5"]),
        (["--image", "absent.mha", "--label", "1"], ["absent.mha", "no such file"]),
        (["--image", "BESIDE", "--label", "1"], ["scan.png", ".tif, .tiff, .mha, .nrrd, .nii"]),
        (["--image", "SCAN", "--label", "200", "--voxel", "7um"], ["--voxel", "100 x 100 x 100"]),
        (["--image", "SCAN", "--label", "7"], ["label is 7", "20 to 200"]),
        (["--image", "SCAN", "--label", "200", "--hold", "faces"], ["end face", "from an image"]),
        (["--image", "SCAN", "--label", "200", "--top-grip", "0mm"], ["end face", "grips above 0"]),
        (["--image", "SCAN", "--label", "200", "--hold", "slot"], ["no slot", "must be shank"]),
    ],
)
def test_an_image_that_is_not_described_is_refused(tmp_path, capsys, options, words):
    write_mha(tmp_path / "scan.mha", pin(100e-6), 100e-6)
    (tmp_path / "scan.png").write_bytes(b"")
    places = {"SCAN": str(tmp_path / "scan.mha"), "BESIDE": str(tmp_path / "scan.png")}
    options = [places.get(option, option) for option in options]
    out = tmp_path / "run"
    refused(capsys, ["geometry", *BASE, "--out", str(out), *options], *words)
    assert not out.exists()


def test_geometry_says_what_it_found(tmp_path, capsys):
    values = pin(100e-6)
    values[0, 0, 0] = 200
    write_mha(tmp_path / "scan.mha", values, 100e-6)
    options = ["--image", str(tmp_path / "scan.mha"), "--threshold", "100", "--quiet"]
    coarse = ["--spacing", "300um", "--horizon", "600um", "--radial-margin", "1mm"]
    coarse += ["--axial-margin", "1mm", "--mesh-size", "0.5mm"]
    out = tmp_path / "run"
    assert main(["geometry", *BASE, *options, *coarse, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "removed_bodies: 1" in printed and f"metal_voxels: {(values > 20).sum() - 1}" in printed
    stored = json.loads(Path(out, "geometry", "geometry.json").read_text())["image"]
    assert stored["voxels"] == list(values.shape) and stored["cut_by_edge"] == []


@pytest.mark.slow
def test_run_takes_a_scan_to_its_strength(tmp_path, capsys):
    """The pin of a scan and the same pin as a solid lose the same share of their strength."""
    radius = ScrewParameters(thread="none", slot_width=0.0, slot_depth=0.0).pin_diameter / 2
    write_tiff(tmp_path / "scan.tif", pin(40e-6, radius, 4e-3))
    scan = ["--image", str(tmp_path / "scan.tif"), "--voxel", "40um", "--threshold", "100"]
    same = ["--thread", "none", "--slot-width", "0mm", "--slot-depth", "0mm"]
    left = {}
    for name, geometry in (("scan", scan), ("solid", same)):
        out = tmp_path / name
        command = ["run", *BASE, *geometry, "--bottom-grip", "0.6mm", "--top-grip", "0.6mm"]
        assert main([*command, "--quiet", "--out", str(out)]) == 0
        rows = (out / "summary.csv").read_text().splitlines()
        names = rows[0].split(",")
        last = dict(zip(names, rows[-1].split(","), strict=True))
        left[name] = {key: float(last[key]) for key in ("strength_ratio", "volume_loss")}
        assert (out / "report.html").exists()
    assert "Voxels of metal" in (tmp_path / "scan" / "report.html").read_text()
    assert 0.05 < left["solid"]["volume_loss"] < 0.5
    # 0.830 and 0.827 measured; of the losses, 11.4 and 11.9 %, the quick lattice allows 6.6 % error
    for key, allowed in (("strength_ratio", 0.02), ("volume_loss", 0.07)):
        assert left["scan"][key] == pytest.approx(left["solid"][key], rel=allowed)
