"""The corrosion stage: what it does with a checkpoint that is not of its march."""

import argparse
from dataclasses import replace

import h5py
import numpy as np
import pytest

from peri.engine.checkpoints import write_checkpoint
from pipeline.scene.options import add_scene_options, scene_from_options
from pipeline.stages import corrosion as corrosion_stage
from pipeline.stages.corrosion import CHECKPOINT_FILE, CORROSION_FILE, corrode_in_folder
from pipeline.stages.geometry import write_geometry

PIN = ["--alloy", "Mg-10Gd", "--immersion", "8w", "--thread", "none", "--mesh-size", "0.6mm"]
PIN += ["--spacing", "250um", "--horizon", "250um", "--radial-margin", "0.5mm"]
PIN += ["--axial-margin", "0.5mm"]


@pytest.fixture(scope="module")
def scene():
    parser = argparse.ArgumentParser()
    add_scene_options(parser)
    return scene_from_options(parser.parse_args(PIN))


@pytest.fixture(scope="module")
def geometry(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("geometry")
    write_geometry(scene, folder)
    return folder


@pytest.fixture
def marches(monkeypatch):
    """Whether each march that is begun resumes."""
    begun = []

    def counted(*arguments, **keywords):
        begun.append(keywords["resume"])
        return march(*arguments, **keywords)

    march = corrosion_stage.corrode_lean
    monkeypatch.setattr(corrosion_stage, "corrode_lean", counted)
    return begun


def test_a_checkpoint_that_is_not_of_this_march_is_dropped(scene, geometry, marches, tmp_path):
    fields = []
    for content in (None, "foreign", "damaged"):
        out = tmp_path / str(content)
        out.mkdir()
        if content == "foreign":
            write_checkpoint(out / CHECKPOINT_FILE, "another", {"scalars": np.zeros(5)})
        elif content == "damaged":
            (out / CHECKPOINT_FILE).write_bytes(b"no HDF5")
        corrode_in_folder(scene, "Mg-10Gd", geometry, out)
        assert not (out / CHECKPOINT_FILE).exists()
        with h5py.File(out / CORROSION_FILE) as file:
            fields.append(file["concentration"][:])
    assert marches == [False, True, False, True, False]
    assert np.array_equal(fields[0], fields[1]) and np.array_equal(fields[0], fields[2])


def test_a_march_that_fails_is_not_repeated(scene, geometry, marches, tmp_path):
    """Faraday's law fills a closed liquid without saturation, after steps with checkpoints."""
    laws = {"dissolution": "faradaic", "saturation": "none", "kinetics": "constant"}
    alloy = scene.alloys[0]
    numbers = replace(alloy.corrosion, liquid_diffusivity=1e-20, interface_diffusivity=1e-12)
    filling = replace(
        scene,
        corrosion=replace(scene.corrosion, **laws),
        domain=replace(scene.domain, boundary="no_flux"),
        alloys=(replace(alloy, corrosion=numbers),),
    )
    with pytest.raises(ValueError, match="the liquid fills beyond the metal's concentration"):
        corrode_in_folder(filling, "Mg-10Gd", geometry, tmp_path, checkpoint_every=0.0)
    assert (tmp_path / CHECKPOINT_FILE).exists()
    assert marches == [False]
