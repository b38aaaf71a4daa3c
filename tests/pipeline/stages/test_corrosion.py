"""The corrosion stage: checkpoints that are not of its march, the degradation rate."""

import argparse
from dataclasses import replace

import h5py
import numpy as np
import pytest

from peri.engine.march.checkpoints import write_checkpoint
from pipeline.scene.command.options import add_scene_options, scene_from_options
from pipeline.stages import corrosion as corrosion_stage
from pipeline.stages.corrosion import (
    CHECKPOINT_FILE,
    CORROSION_FILE,
    HISTORY_FILE,
    corrode_in_folder,
    degradation_rate,
)
from pipeline.stages.geometry import read_surface, write_geometry
from tests.pipeline.geometry.solids import reference_screw

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


def test_degradation_rate_of_the_solid_itself(scene, geometry, tmp_path):
    """(5.34) with the solid's own volume and area, in the record and in the history."""
    _, numbers = corrode_in_folder(scene, "Mg-10Gd", geometry, tmp_path)
    solid = read_surface(geometry)
    years = 56 / 365.25
    expected = 1e3 * numbers["volume_loss"][1] * solid.volume / (solid.area * years)
    assert numbers["degradation_rate"] == [None, pytest.approx(expected, rel=1e-12)]
    history = np.genfromtxt(tmp_path / HISTORY_FILE, delimiter=",", names=True)
    assert history["degradation_rate_mm_per_year"][-1] == pytest.approx(expected, rel=1e-10)
    assert np.isnan(history["degradation_rate_mm_per_year"][0])


def test_degradation_rate_of_the_published_screw():
    """15.457 % of the M2 x 4 mm screw in 56 days."""
    screw = reference_screw()
    assert degradation_rate(0.15456919, 56 * 86400.0, screw) == pytest.approx(0.2184, abs=5e-5)
