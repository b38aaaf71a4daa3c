"""Exported files, read back by other programs' readers, hold what the run folder holds."""

import shutil
import subprocess
from dataclasses import replace

import h5py
import meshio
import numpy as np
import pytest
from scipy.io import netcdf_file

from pipeline.cli import main
from pipeline.export.inp import damage_classes, write_inp
from pipeline.export.state import CorrodedState, read_state
from pipeline.geometry.mesh import cell_volumes
from pipeline.life_cycle import StagedRun
from pipeline.planning.opening import open_run
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import (
    DomainSettings,
    HoldScene,
    MaterialParameters,
    MeshSettings,
    ScrewGeometry,
    TensileScene,
)
from pipeline.scene.screw import ScrewParameters
from pipeline.scene.units import ImmersionTime
from tests.fem.meshes import box


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder up to the damage map: a plain pin on a coarse lattice and mesh."""
    scene = resolve_scene(
        ["Mg-5Gd"],
        ["0w", "8w"],
        "quick",
        geometry=ScrewGeometry(ScrewParameters(thread="none")),
        spacing=250e-6,
        horizon=250e-6,
        domain=DomainSettings(radial_margin=0.5e-3, axial_margin=0.5e-3),
        mesh_size=0.6e-3,
        tensile={"element": "P2", "damage": "point"},
    )
    with open_run(scene, tmp_path_factory.mktemp("export") / "run", False) as (folder, solid):
        cycle = StagedRun(scene, folder, solid=solid)
        cycle.geometry()
        cycle.corrode("Mg-5Gd")
        for moment in scene.immersion:
            cycle.map("Mg-5Gd", moment, scene.holds[0])
    return folder.path


def bar(strength: np.ndarray | float = 1.0, element: str = "P2", **test: object) -> CorrodedState:
    """A bar of 1 x 1 x 3 mm whose cells keep these shares of their strength."""
    points, cells = box((2, 2, 6), (1e-3, 1e-3, 3e-3))
    turned = cell_volumes(points, cells) < 0
    cells[turned] = cells[turned][:, [0, 2, 1, 3]]
    material = MaterialParameters(43e9, 0.3, 130e6, 156e6, 10.6)
    damage = (1.0 - np.broadcast_to(strength, (len(cells),))) / material.q1
    values = {"final_strain": 0.02, "increment": 0.01, **test}
    hold = HoldScene("faces", MeshSettings(1e-3, 5e-4), TensileScene(element, **values))
    return CorrodedState(
        "Mg-A", ImmersionTime("8w", 4838400.0), hold, material, points, cells, damage, None
    )


def exported(run, tmp_path, form: str, suffix: str):
    """Path of the file that the command wrote."""
    path = tmp_path / f"pin{suffix}"
    assert main(["export", str(run), "--to", form, "--time", "56d", "--out", str(path)]) == 0
    return path


def test_the_state_is_that_of_the_run(run):
    state = read_state(run, "56d")
    with h5py.File(run / "Mg-5Gd" / "8w" / "shank" / "damage.h5") as file:
        f0 = file["f0"][:]
    assert f0.shape[1] == 4 and f0.std(axis=1).max() > 0.01
    np.testing.assert_allclose(state.corrosion_damage, f0.mean(axis=1), rtol=1e-14)
    assert 0.01 < state.corrosion_damage.mean() < 0.5
    assert read_state(run, "0w").corrosion_damage.max() == 0.0


@pytest.mark.parametrize("form, suffix", [("vtu", ".vtu"), ("xdmf", ".xdmf")])
def test_meshes_are_read_back_equal(run, tmp_path, form, suffix):
    state, there = read_state(run, "8w"), meshio.read(exported(run, tmp_path, form, suffix))
    np.testing.assert_array_equal(there.points, state.points)
    np.testing.assert_array_equal(there.cells_dict["tetra"], state.cells)
    np.testing.assert_array_equal(there.cell_data["corrosion_damage"][0], state.corrosion_damage)
    np.testing.assert_array_equal(there.cell_data["strength_left"][0], state.strength_left)
    np.testing.assert_array_equal(there.point_data["grip"], state.grips())
    assert {0, 1, 2} == set(there.point_data["grip"])


def test_exodus_is_read_back_equal(run, tmp_path):
    state = read_state(run, "8w")
    with netcdf_file(exported(run, tmp_path, "exodus", ".exo"), mmap=False) as file:
        there = {name: variable[:].copy() for name, variable in file.variables.items()}
    names = [b"".join(row).rstrip(b"\0").decode() for row in there["name_elem_var"]]
    np.testing.assert_array_equal(
        np.c_[there["coordx"], there["coordy"], there["coordz"]], state.points
    )
    np.testing.assert_array_equal(there["connect1"] - 1, state.cells)
    values = there[f"vals_elem_var{names.index('corrosion_damage') + 1}eb1"][0]
    np.testing.assert_array_equal(values, state.corrosion_damage)
    assert there["time_whole"].tolist() == [56 * 86400.0]


def test_npz_holds_all_arrays(run, tmp_path):
    state, there = read_state(run, "8w"), np.load(exported(run, tmp_path, "npz", ".npz"))
    np.testing.assert_array_equal(there["points"], state.points)
    np.testing.assert_array_equal(there["corrosion_damage"], state.corrosion_damage)
    with h5py.File(run / "Mg-5Gd" / "corrosion" / "corrosion.h5") as file:
        np.testing.assert_array_equal(there["lattice_concentration"], file["concentration"][1])
    lost = 1.0 - there["lattice_concentration"] / there["solid_concentration"]
    assert 0.01 < lost[there["lattice_metal"]].mean() < 0.9
    assert there["material_q1"] == 1.5


def test_the_deck_is_read_back_equal(run, tmp_path):
    """Corners and cells by meshio; a material per class, whose cells have its strength."""
    state, path = read_state(run, "8w"), exported(run, tmp_path, "inp", ".inp")
    there = meshio.read(path)
    classes = damage_classes(state)
    kept = classes.number >= 0
    cells = np.concatenate([block.data for block in there.cells])
    assert {block.type for block in there.cells} == {"tetra10"}
    centres = there.points[cells[:, :4]].mean(axis=1)
    ours = 1e3 * state.points[state.cells[kept]].mean(axis=1)
    order = np.argsort(classes.number[kept], kind="stable")
    np.testing.assert_allclose(centres, ours[order], atol=1e-9)
    middle = there.points[cells[:, 4]]
    np.testing.assert_allclose(middle, there.points[cells[:, :2]].mean(axis=1), atol=1e-9)
    text = path.read_text()
    strength = [float(part.split(",")[0]) / 43e3 for part in text.split("*ELASTIC\n")[1:]]
    np.testing.assert_allclose(strength, classes.strength, rtol=1e-9)
    assert len(strength) > 3
    np.testing.assert_allclose(
        state.strength_left[kept], classes.strength[classes.number[kept]], atol=1.0 / 20
    )


def test_classes_keep_the_mean_strength_and_leave_out_what_is_gone():
    random = np.random.default_rng(1).uniform(0.3, 1.0, 144)
    random[:4], random[4] = 1.0, 0.01
    classes = damage_classes(bar(random), 7)
    assert (classes.number < 0).sum() == 1 and classes.number[4] == -1
    assert classes.strength[-1] == 1.0 and (classes.number[:4] == len(classes.strength) - 1).all()
    kept = classes.number >= 0
    assert classes.strength[classes.number[kept]].mean() == pytest.approx(random[kept].mean())


def test_bars_that_cannot_be_pulled_are_refused(tmp_path):
    severed = np.ones(144)
    points, cells = box((2, 2, 6), (1e-3, 1e-3, 3e-3))
    height = points[cells].mean(axis=1)[:, 2]
    severed[(height > 1e-3) & (height < 1.5e-3)] = 0.0
    with pytest.raises(ValueError, match="severed: no piece joins both grips"):
        write_inp(bar(severed), tmp_path / "bar.inp")
    turned = replace(bar().hold, tensile=TensileScene(load="torsion", lateral="clamped"))
    with pytest.raises(ValueError, match="load of the run is torsion"):
        write_inp(replace(bar(), hold=turned), tmp_path / "bar.inp")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "change, words",
    [
        ({"--to": "stl"}, "--to is 'stl'"),
        ({"--time": "4w"}, "immersion time '4w' is not part of this run"),
        ({"--time": "soon"}, "time 'soon' is not understood"),
        ({"--hold": "slot"}, "hold 'slot' is not part of this run"),
        ({"--alloy": "Mg-9"}, "alloy 'Mg-9' (did you mean Mg-5Gd?) is not part of this run"),
        ({"--classes": "0"}, "--classes is 0; it must be 1 to 200"),
        ({"--out": "a.vtu"}, "a file of format inp ends in .inp"),
        ({"--out": "nowhere/a.inp"}, "whose folder does not exist"),
    ],
)
def test_refusals(run, capsys, change, words):
    options = {"--to": "inp", "--time": "8w", **change}
    arguments = ["export", str(run), *(word for pair in options.items() for word in pair)]
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert words in said.err and said.err.count("\n") == 1 and said.out == ""
    assert not list(run.glob("export/*"))


def test_a_map_that_was_changed_is_not_exported(run, tmp_path, capsys):
    shutil.copytree(run, tmp_path / "run")
    with open(tmp_path / "run" / "Mg-5Gd" / "8w" / "shank" / "damage.h5", "ab") as file:
        file.write(b"x")
    assert main(["export", str(tmp_path / "run"), "--to", "vtu", "--time", "8w"]) == 2
    assert "stage 'map' of 'Mg-5Gd/8w/shank' is not complete" in capsys.readouterr().err


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_calculix_runs_the_deck_as_it_is(tmp_path, element):
    """A bar of two halves side by side that keep all and 60 % of their strength and moduli.

    Both have the same strains, so the bar stays uniform: the force by hand is that of 80 %.
    """
    points, cells = box((2, 2, 6), (1e-3, 1e-3, 3e-3))
    weak = points[cells].mean(axis=1)[:, 0] > 0.5e-3
    write_inp(bar(np.where(weak, 0.6, 1.0), element), tmp_path / "bar.inp")
    force = calculix_force(tmp_path, "bar", 120)
    for strain, got in zip((0.01, 0.02), force, strict=True):
        flow = 130.0
        for _ in range(50):
            plastic = np.log1p(strain) - flow / 43e3
            flow = 130.0 + 156.0 * (1.0 - np.exp(-10.6 * plastic))
        area = np.exp(-plastic - 2.0 * 0.3 * flow / 43e3)
        # measured 9.7e-4: the elastic law is another, and the table linear between its points
        assert got == pytest.approx(0.8 * flow * area, rel=2e-3)


@pytest.mark.slow
def test_peak_of_the_exported_screw_is_ours(tmp_path):
    """The intact screw, held by the shank, on a coarse mesh of ten-node cells to 10 %."""
    from fem.constitutive import Material, VoceHardening
    from fem.solid import Grips
    from fem.strength import TensileSettings, tensile_test
    from pipeline.geometry.solids import screw_solid, tetrahedral_mesh

    mesh = tetrahedral_mesh(screw_solid(ScrewParameters(pitch=0.4e-3)), 0.5e-3, 0.35e-3)
    test = {"final_strain": 0.1, "increment": 0.01, "bottom_grip": 0.7e-3, "top_grip": 0.7e-3}
    hold = HoldScene("shank", MeshSettings(1e-3, 5e-4), TensileScene("P2", **test))
    intact = np.zeros(len(mesh.cells))
    state = replace(bar(), hold=hold, points=mesh.points, cells=mesh.cells, corrosion_damage=intact)
    write_inp(state, tmp_path / "screw.inp")
    theirs = calculix_force(tmp_path, "screw", 1200).max()
    material = Material(43e9, 0.3, VoceHardening(130e6, 156e6, 10.6))
    ours = tensile_test(
        mesh.points, mesh.cells, 0.0, material,
        TensileSettings("P2", maximum_increment=0.01, grips=Grips(0.7e-3, 0.7e-3)),
    ).peak_force  # fmt: skip
    assert ours > 300
    # 0.22 % on the mesh of `quick` (perilife bench friendliness), less than the bound here
    assert theirs == pytest.approx(ours, rel=0.003)


def calculix_force(folder, name: str, timeout: float) -> np.ndarray:
    """Total force [N] along z of the top grip after every increment of a deck."""
    done = subprocess.run(
        ["ccx", name], cwd=folder, capture_output=True, text=True, timeout=timeout
    )
    assert "Job finished" in done.stdout, done.stdout[-2000:]
    lines = (folder / f"{name}.dat").read_text().splitlines()
    rows = [line.split() for line in lines]
    return np.array([float(row[2]) for row in rows if len(row) == 3])
