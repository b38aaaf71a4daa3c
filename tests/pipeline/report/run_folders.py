"""Run folders for the tests of the report, synthetic, in exactly the layout of the pipeline."""

import csv
import html.parser
import json

import h5py
import numpy as np

from pipeline.record.run_folder import RunFolder, StageRecord
from pipeline.record.summary import SummaryRow, write_summary
from pipeline.scene.loads import LOADS
from pipeline.scene.resolve import resolve_scene
from pipeline.stages.damage_map import compare_lost_volume

WEEKS = ("0w", "4w", "8w", "24w")
LEFT_OUT = [
    {"name": "solid_core", "reason": "beyond reach", "bound": 0.00042, "applied": True},
    {"name": "liquid", "reason": "needed", "bound": 1.0, "applied": False},
]
RATIOS = {"Mg-5Gd": (1.0, 0.71, 0.43, 0.0), "Mg-10Gd": (1.0, 0.82, 0.64, 0.21)}


def pin_mesh(spacing=4e-4, radius=1e-3, length=4e-3):
    """A cylinder of tetrahedra: points (n, 3) m and cells (nc, 4)."""
    from scipy.spatial import Delaunay

    layers, rings = round(length / spacing), round(radius / spacing)
    points = []
    for z in np.linspace(0.0, length, layers + 1):
        points.append((0.0, 0.0, z))
        for ring in range(1, rings + 1):
            angle = 2 * np.pi * np.arange(6 * ring) / (6 * ring)
            r = radius * ring / rings
            points += list(zip(r * np.cos(angle), r * np.sin(angle), 0 * angle + z, strict=True))
    points = np.array(points)
    jitter = 1e-8 * np.random.default_rng(0).normal(size=points.shape)
    cells = Delaunay(points + jitter).simplices.astype(np.int64)
    corner = points[cells]
    volume = np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1])) / 6
    return points, cells[volume > 1e-4 * spacing**3]


def scene_of(alloys=tuple(RATIOS), weeks=WEEKS, **changes):
    """A resolved scene with shipped data."""
    return resolve_scene(list(alloys), list(weeks), **changes)


def write_csv(path, columns):
    """Write arrays as the pipeline does: names in the first line."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="") as handle:
        writer = csv.writer(handle)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def lost_volume():
    """Numbers of a map whose mesh holds 1.23 % less of the loss than the lattice."""
    concentration = np.full((2, 2, 2), 0.5)
    metal = np.ones((2, 2, 2), bool)
    weights = np.full((1, 1), 8 * (1 - 0.0123))
    return compare_lost_volume(
        np.full((1, 1), 0.5), weights, 1.0, concentration, metal, np.ones((2, 2, 2)), 1.0
    )


def write_run(path, scene, points, cells):
    """Fill a run folder with plausible results of every stage."""
    folder = RunFolder(path)
    folder.geometry.mkdir(parents=True)
    folder.scene_file.write_text(json.dumps(scene.to_json()))
    with h5py.File(folder.geometry / "mesh.h5", "w") as file:
        file["points"], file["cells"] = points, cells
    quality = {
        "volume": 9.3e-9,
        "area": 42e-6,
        "reference_volume": 9.25e-9,
        "mesh": {"volume": 9.2e-9, "min_shape": 0.31},
    }
    (folder.geometry / "geometry.json").write_text(json.dumps(quality))
    record(folder, folder.geometry, "geometry", 3.0)
    middle = points[cells].mean(axis=1)
    depth = np.minimum(1e-3 - np.hypot(middle[:, 0], middle[:, 1]), 2e-3 - abs(middle[:, 2] - 2e-3))
    rows = []
    for alloy in scene.alloys:
        time = np.linspace(0.0, scene.immersion[-1].seconds, 40)
        loss = 0.25 * np.log10(1 + 9 * time / 1.5e7)
        balance = np.full_like(time, 3e-13)
        columns = {"time": time, "volume_loss": loss, "balance_error": balance}
        write_csv(folder.corrosion(alloy.name) / "history.csv", columns)
        record(folder, folder.corrosion(alloy.name), "corrode", 40.0, omissions=LEFT_OUT)
        for moment, ratio in zip(scene.immersion, RATIOS[alloy.name], strict=False):
            for hold in scene.holds:
                place = folder.test(alloy.name, moment.label, hold.name)
                place.mkdir(parents=True)
                damage = np.clip(0.9 - depth / (2e-3 * (1.01 - ratio)), 0, 2 / 3) * (ratio < 1)
                with h5py.File(place / "damage.h5", "w") as file:
                    file["f0"] = np.repeat(damage[:, None], 4, axis=1)
                section = {"net_section_left": 0.9 * ratio}
                record(folder, place, "map", 0.5, **lost_volume(), **section)
                strain = np.linspace(0, 0.1, 21)
                force = 500 * ratio * (1 - np.exp(-60 * strain)) * (1 - strain)
                work = np.cumsum(force) * 2e-5
                columns = {"elongation": strain, "displacement_m": 4e-3 * strain, "force_N": force}
                if scene.tensile.load != "axial":
                    force *= 2e-4
                    names = LOADS[scene.tensile.load]
                    reaction = f"{names.reaction}_{names.unit}"
                    columns = {"strain": strain, "angle_rad": 4 * strain, reaction: force}
                energy = {"work_J": work, "stored_J": 0.2 * work, "dissipated_J": 0.798 * work}
                write_csv(place / "tensile.csv", columns | energy)
                status = "severed" if ratio == 0 else "completed"
                found = {"status": status, "cells": 3698, "torn_cells": 7 if ratio < 0.7 else 0}
                found["lag_at_peak"] = 0.0031 if ratio < 0.7 else 0.0004
                names = LOADS[scene.tensile.load]
                found |= {f"peak_{names.reaction}": float(force.max()), names.strain_at_peak: 0.045}
                (place / "tensile.json").write_text(json.dumps(found))
                record(folder, place, "pull", 12.0)
                rows.append(
                    SummaryRow(
                        alloy.name,
                        hold.name,
                        moment.days,
                        float(np.interp(moment.seconds, time, loss)),
                        float(damage.mean()),
                        float(force.max()),
                        ratio,
                        0.045 if ratio else 0.0,
                        status,
                        scene.tensile.load,
                    )
                )
    write_summary(folder.summary_file, rows)
    return path


def record(folder, place, stage, seconds, **numbers):
    """Write the record of a finished stage."""
    place.mkdir(parents=True, exist_ok=True)
    entry = StageRecord(stage, "0", seconds, numbers=numbers, versions={"perilife": "0.1.0"})
    folder.write_record(place, entry)


class Page(html.parser.HTMLParser):
    """Reads a page: its tags in order, what it would load, its text by section."""

    def __init__(self, text):
        super().__init__()
        self.open, self.loads, self.sections, self._section = [], [], {}, ""
        self.pictures, self.skip = [], False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.skip = tag in ("style", "script")
        if tag in ("section", "header"):
            self._section = attributes.get("id", "header")
        if tag not in ("meta", "img", "br", "input"):
            self.open.append(tag)
        if tag == "img":
            self.pictures.append(attributes)
        for name in ("src", "href", "xlink:href", "srcset"):
            if not attributes.get(name, "#").startswith(("#", "data:")):
                self.loads.append(attributes[name])

    def handle_endtag(self, tag):
        self.skip = False
        while self.open and self.open.pop() != tag:
            raise AssertionError(f"tag {tag} closes another one")

    def handle_data(self, data):
        if not self.skip:
            self.sections[self._section] = self.sections.get(self._section, "") + data
