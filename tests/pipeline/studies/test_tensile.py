"""The studies of the tensile stage and of the whole life cycle: arithmetic, tables, presets."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from fem.quadrature import quadrature_points
from pipeline.scene.mapping import mapping_of
from pipeline.scene.mechanics import EXPOSURES
from pipeline.scene.resolution import NAMES, read_presets
from pipeline.scene.resolve import resolve_scene
from pipeline.studies import life_cycle
from pipeline.studies import tensile as study
from pipeline.studies import tensile_results as results
from pipeline.studies.workshop import (
    Pull,
    Row,
    Workshop,
    mapped_damage,
    read_rows,
    write_rows,
)
from tests.fem.meshes import box

EXACT = {"0w": 450.0, "8w": 270.0}


def rows_of_order_one():
    """Peak forces exact * (1 + c h^order): P2-Fbar order 2, P1-Fbar order 1, increments order 1."""
    rows = []

    def add(curve, t, cells, size, force, seconds, **more):
        base = Row(
            curve, f"{1e3 * size:g} mm", "Mg", t, study.REFERENCE, size, size, study.INCREMENT,
            cells=cells, peak_force=force, processor_seconds=seconds, increments=20, iterations=7,
            status="past_peak",
        )  # fmt: skip
        rows.append(replace(base, **more))

    for t, exact in EXACT.items():
        corroded = float(t != "0w")
        for n in (2, 4, 8):
            h = 1.0 / n
            error = 0.8 * h**2 * corroded
            add(study.REFERENCE, t, n**3, 1e-3 * h, exact * (1 + error), 10.0 * n**3)
            error = 0.8 * h * corroded
            add("P1-Fbar", t, n**3, 1e-3 * h, exact * (1 + error), float(n**3), element="P1-Fbar")
        for x in (0.02, 0.01, 0.005):
            force = exact * (1 + 2 * x * corroded)
            add(
                study.INCREMENT_CURVE, t, 8, 0.25e-3, force, 0.05 / x, element="P1-Fbar",
                increment=x, increments=round(0.2 / x), samples=3,
            )  # fmt: skip
    return rows


def test_the_limit_of_the_meshes_is_exact_for_a_power_of_the_size():
    sizes = np.array([0.5, 0.25, 0.125])
    for order in (1.0, 1.5, 2.0):
        value, uncertainty = study.limit_of(sizes, 5.0 + 3.0 * sizes**order)
        assert value == pytest.approx(5.0, abs=1e-9)
        assert uncertainty == pytest.approx(3.0 * sizes[-1] ** order)
    # Where the values go to and fro, nothing is extrapolated and all of it is doubt.
    assert study.limit_of(sizes, [5.0, 5.4, 5.1]) == pytest.approx((5.1, 0.4))
    assert study.limit_of(sizes[:2], [5.0, 5.4]) == pytest.approx((5.4, 0.4))


def test_errors_of_ratio_and_increment_are_those_put_in():
    errors = study.Errors(study.Study(tuple(rows_of_order_one())), "Mg")
    assert errors.ratio["8w"][0] == pytest.approx(270 / 450)
    coarse = errors.curve("P1-Fbar", "8w")[0]
    # 40 % of the mesh, and the distance of the finest mesh from the limit: 0.8 / 64.
    assert errors.ratio_error(coarse) == pytest.approx(0.4 + 0.0125)
    assert errors.force_error(coarse) == pytest.approx(0.4)
    assert errors.increment_errors() == pytest.approx({0.02: 0.04, 0.01: 0.02, 0.005: 0.01})


def test_the_cheapest_setting_is_within_the_error_and_the_seconds():
    found = study.settings(study.Study(tuple(rows_of_order_one())))
    assert len(found) == 6 * 3
    best, reached = study.cheapest(found, 0.5)
    assert reached and best.element == "P1-Fbar" and best.error <= 0.5
    assert best.seconds == min(s.seconds for s in found if s.error <= 0.5)
    weaker = [replace(s, force_error=0.6) if s is best else s for s in found]  # counts, too
    other, reached = study.cheapest(weaker, 0.5)
    assert reached and other is not best and other.seconds >= best.seconds
    best, reached = study.cheapest(found, 1e-3)
    assert not reached and best.element == study.REFERENCE
    best, reached = study.cheapest(found, 1e-3, most=100.0)
    assert not reached and best.seconds <= 100.0


def test_a_mesh_with_a_test_that_stopped_is_no_setting():
    rows = rows_of_order_one()
    broken = [
        replace(r, status="stopped: no prediction") if r.curve == "P1-Fbar" and r.cells == 8 else r
        for r in rows
    ]
    before, after = (study.settings(study.Study(tuple(r))) for r in (rows, broken))
    assert len(before) - len(after) == 3
    assert any("stopped" in line for line in results.tables(study.Study(tuple(broken))))


def test_without_a_reference_at_every_time_nothing_is_chosen():
    rows = [
        r
        for r in rows_of_order_one()
        if (r.curve, r.immersion) != (study.REFERENCE, "8w") or r.cells < 9
    ]
    short = study.Study(tuple(rows))
    assert len([r for r in rows if r.curve == study.REFERENCE and r.immersion == "8w"]) == 1
    assert study.settings(short) == []
    with pytest.raises(RuntimeError, match="nothing to choose from"):
        results.presets_text(short, "the command")
    assert any("not reached by any" in line for line in results.tables(short))


def test_the_files_of_the_study_are_whole_and_its_presets_can_be_read(tmp_path):
    whole = study.Study(tuple(rows_of_order_one()))
    paths = results.write_study(whole, tmp_path, "the command")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(p.name for p in paths)
    assert repr(read_rows(paths[0])) == repr(list(whole.rows))
    text = paths[1].read_text()
    assert "P2-Fbar: observed order of the peak force in the edge: nan (0w), 2.0 (8w)" in text
    assert "increment: observed order of the strength left 1.0" in text
    assert paths[2].read_bytes().startswith(b"\x89PNG")
    presets = read_presets(tensile=paths[3])
    assert list(presets) == list(NAMES)
    fine = presets["fine"]
    assert (fine.element, fine.increment, fine.mesh_size) == (study.REFERENCE, 0.005, 0.125e-3)
    # mesh 0.0125 twice (its own and that of the limit) and increment 0.01, two digits of each
    assert fine.tensile_error.error == pytest.approx(0.035, rel=0.03)
    assert fine.tensile_error.latest == "8w"


def test_every_pull_of_the_study_is_planned_with_its_intact_screw():
    for long in (False, True):
        pulls = study.plan_pulls(["Mg-5Gd"], ["8w"], long)
        assert {p.curve for p in pulls} >= {*study.MESH_CURVES, study.INCREMENT_CURVE}
        meshes = {(p.element, p.mesh_size) for p in pulls if p.curve in study.MESH_CURVES}
        for element, size in meshes:
            times = {p.immersion for p in pulls if (p.curve, p.mesh_size) == (element, size)}
            assert times == {"0w", "8w"}
        near = {p.mesh_size for p in pulls if p.curve == study.SCATTER_CURVE}
        assert min(near) < study.QUICK[0] < max(near) < 1.05 * study.QUICK[0]
    assert len(study.plan_pulls(["A"], ["8w"], True)) > len(study.plan_pulls(["A"], ["8w"]))


def test_the_study_pulls_what_a_run_pulls_and_goes_on_where_it_was(tmp_path, monkeypatch):
    scenes, asked = [], []

    def corrode(self, alloy, immersion, name="", **changes):
        assert name == "" and self.folder == tmp_path
        scenes.append(self.scene(alloy, immersion, **changes))

    def pull(self, pulls, workers, done):
        asked.extend(pulls)
        for p in pulls:
            done(Row(**asdict(p), peak_force=1.0, strain_at_peak=0.1, status="completed"))

    monkeypatch.setattr(Workshop, "corrode", corrode)
    monkeypatch.setattr(Workshop, "pull", pull)
    rows = tmp_path / "rows.csv"
    found = study.study_tensile(["Mg-5Gd"], ["8w"], workers=1, rows=rows, keep=tmp_path)
    (scene,) = scenes
    assert scene == resolve_scene(["Mg-5Gd"], ["0w", "8w"], "quick")
    assert mapping_of(scene, scene.tensile) == EXPOSURES
    run = (scene.tensile.element, scene.mesh.size, scene.mesh.size_fine, scene.tensile.increment)
    plain = [p for p in asked if (p.element, p.mesh_size, p.mesh_size_fine, p.increment) == run]
    assert any((p.damage, p.samples, p.grip, p.field) == ("point", 1, None, "") for p in plain)
    assert len({study._identity(p) for p in asked}) == len(asked) < len(found.rows)
    assert read_rows(rows) == list(found.rows)


def test_the_scatter_is_the_spread_over_meshes_of_about_one_size():
    rows = rows_of_order_one()
    size, cells = 0.25e-3, 64
    for t, force in (("0w", 450.0), ("8w", 300.0)):
        base = next(
            r for r in rows if (r.curve, r.immersion, r.mesh_size) == (study.REFERENCE, t, size)
        )
        for near, factor in ((0.98 * size, 1.0), (1.02 * size, 1.02)):
            more = {"mesh_size": near, "mesh_size_fine": near, "cells": cells}
            corroded = force * factor if t != "0w" else force
            rows.append(replace(base, curve=study.SCATTER_CURVE, peak_force=corroded, **more))
    whole = study.Study(tuple(rows))
    # 300/450, 306/450 and, of the mesh between, 270 (1 + 0.05) / 450
    ratios = np.array([300.0, 306.0, 270.0 * 1.05]) / 450.0
    assert study.Errors(whole, "Mg").scatter("8w") == pytest.approx(np.ptp(ratios) / ratios.mean())
    assert any("meshes of about one size: 7.59 % (8w)" in line for line in results.tables(whole))
    assert np.isnan(study.Errors(study.Study(tuple(rows_of_order_one())), "Mg").scatter("8w"))


def test_a_pull_is_done_once_in_a_process_of_its_own_and_given_up_in_time(tmp_path, monkeypatch):
    points, cells = box((2, 2, 4), (1e-3, 1e-3, 2e-3))
    np.savez(tmp_path / "mesh-300-200.npz", points=points, cells=cells)
    metal = np.ones((4, 4, 4), bool)
    np.savez(
        tmp_path / "field--Mg-5Gd-8w.npz", origin=[-5e-4] * 3, spacing=[1e-3] * 3,
        concentration=np.full(metal.shape, 0.9 * 66082.4), metal=metal, solid=66082.4,
        capacity=np.full(metal.shape, 2.0 / metal.size),  # of a cell: the box's 2 mm^3
    )  # fmt: skip
    pull = Pull("a", "b", "Mg-5Gd", "8w", "P1", 0.3e-3, 0.2e-3, 0.01)
    heard = []
    rows = Workshop(tmp_path).pull([pull, replace(pull, increment=0.02)], 1, heard.append)
    assert [r.increment for r in rows] == [0.01, 0.02] and len(heard) == 2
    assert all(r.peak_force > 1 and not r.status.startswith("stopped") for r in rows)
    long = replace(pull, increment=1e-5)
    late = Workshop(tmp_path).pull([long], 1, heard.append, limit=0.05)
    assert late[0].status == "stopped: not done within 0 s"
    # the folder has what was done: another workshop in it does none again, on whatever curve
    other = [replace(p, curve="c") for p in (pull, replace(pull, increment=0.02), long)]
    monkeypatch.setattr(Workshop, "mesh", None)  # not asked for
    kept = Workshop(tmp_path).pull(other, 1, heard.append, limit=0.05)
    assert repr(kept) == repr([replace(row, curve="c") for row in (*rows, *late)])
    write_rows([*rows, late[0]], tmp_path / "rows.csv")
    assert repr(read_rows(tmp_path / "rows.csv")) == repr([*rows, late[0]])


@pytest.mark.parametrize(("damage", "samples"), [("cell", 1), ("point", 1), ("point", 2)])
def test_the_mesh_of_a_pull_loses_what_its_lattice_lost(damage, samples):
    points, cells = box((2, 2, 4), (1e-3, 1e-3, 2e-3))
    metal = np.ones((5, 5, 7), bool)
    lost = np.random.default_rng(3).random(metal.shape)
    field = {
        "origin": (-5e-4,) * 3, "spacing": 5e-4, "concentration": 2.0 * (1.0 - lost),
        "metal": metal, "solid": 2.0, "capacity": np.full(metal.shape, 16.0 / metal.size),
    }  # fmt: skip
    pull = Pull(
        "", "", "Mg-5Gd", "8w", "P2", 1e-3, 1e-3, 0.01, damage=damage, samples=samples
    )  # fmt: skip
    found = mapped_damage(points, cells, pull, field, 1.0, Path())
    _, weights = quadrature_points(points, cells, "P2")
    volumes = weights.sum(axis=1, keepdims=True) if damage == "cell" else weights
    assert found.shape == volumes.shape
    assert (found * volumes).sum() == pytest.approx(lost.mean() * 2e-9, rel=1e-12)


def levels():
    made = []
    for factor, order in (("lattice", 1.0), ("time step", 2.0), ("mapping", None)):
        entries = [("coarse", 0.64, 1.0, "past_peak"), ("fine", 0.60, 4.0, "past_peak")]
        made += life_cycle.factor_levels(factor, entries, order)
    made += life_cycle.factor_levels(
        "mesh and element", [("a", 0.63, 5.0, "past_peak"), ("b", 0.6, 50.0, "past_peak")], None
    )
    return made + life_cycle.factor_levels(
        "increment", [("1 %", 0.606, 5.0, "past_peak"), ("0.5 %", 0.603, 9.0, "past_peak")], 1.0
    )


def test_the_rest_of_a_factor_follows_from_its_order():
    by = {(e.factor, e.choice): e.error for e in levels()}
    assert by["lattice", "fine"] == pytest.approx(0.04 / 0.6)
    assert by["time step", "fine"] == pytest.approx(0.04 / 3 / 0.6)
    assert by["mapping", "coarse"] == pytest.approx(0.08 / 0.6)
    assert by["increment", "1 %"] == pytest.approx(0.006 / 0.603)


def test_the_cheapest_combination_is_found_among_all():
    found = life_cycle.combinations(levels())
    assert len(found) == 2**5
    wanted = sorted(c.error for c in found)[10]
    best, reached = life_cycle.cheapest(found, wanted)
    assert reached and best.seconds == min(c.seconds for c in found if c.error <= wanted)
    # corrosion 1 s times 4, pull 50 s times 9/5
    surest, reached = life_cycle.cheapest(found, 1e-6)
    assert not reached and surest.error == min(c.error for c in found)
    assert any("not reached" in line for line in life_cycle.tables(levels(), "Mg, 8w"))


def test_a_combination_costs_march_map_and_pulls():
    made = [replace(e, map_seconds=0.5 * (e.factor == "mesh and element")) for e in levels()]
    first, last = (life_cycle.combinations(made)[i].seconds for i in (0, -1))
    assert first == pytest.approx(1.0 * 1.0 + 0.5 * 1.0 + 5.0 * 1.0)
    assert last == pytest.approx(4.0 * 4.0 + 0.5 * 4.0 + 50.0 * 9.0 / 5.0)
