"""Error against run time of the tensile stage: what each numerical choice costs and buys.

Every pull is that of a `quick` run (its lattice, its map, its increments) with one choice changed:
meshes of four elements, and meshes of about the size of `quick`, which tell scatter from trend; on
one mesh the increments; with `long` the length that the grips hold, tolerance and growth of f,
too.  The reference of a strength left is the limit of the run's element (`limit_of`); how far that
limit lies from the finest mesh is its uncertainty, and part of every error of a ratio.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipeline.studies.workshop import Pull, Row, Workshop, kept_folder, weeks, write_rows

IMMERSION = ("0w", "8w", "24w")
COARSEST, COARSE, QUICK = (0.5e-3, 0.4e-3), (0.4e-3, 0.3e-3), (0.3e-3, 0.2e-3)
MIDDLE, FINE, FINER, FINEST = (
    (0.22e-3, 0.14e-3), (0.2e-3, 0.12e-3), (0.16e-3, 0.1e-3), (0.12e-3, 0.08e-3)
)  # fmt: skip
MESHES = {
    "P2-Fbar": (COARSE, QUICK, FINE, FINER),
    "P2": (COARSE, QUICK, FINE, FINER, FINEST),
    "P1-Fbar": (COARSE, QUICK, FINE, FINEST),
    "P1": (QUICK,),
}
LONG_MESHES = {
    "P2-Fbar": (COARSEST, COARSE, QUICK, MIDDLE, FINE, FINER, FINEST),
    "P2": (COARSEST, COARSE, QUICK, MIDDLE, FINE, FINER, FINEST),
    "P1-Fbar": (COARSE, QUICK, FINE, FINER, FINEST),
    "P1": (COARSE, QUICK, FINE, FINER, FINEST),
}
NEARBY = ((0.29e-3, 0.195e-3), (0.31e-3, 0.205e-3))
"""Meshes of about the size of QUICK: what they differ by is scatter, no trend."""

INCREMENT = 0.02
"""Largest strain increment of the pulls that compare meshes: that of a run."""

INCREMENTS = (0.02, 0.01)
LONG_INCREMENTS = (0.02, 0.01, 0.005, 0.0025, 0.00125)
TOLERANCES = (1e-3, 1e-5, 1e-7)
GRIPS = (0.0, 0.5e-3, None, 0.9e-3)
REFERENCE = "P2-Fbar"
"""The element of a run, whose limit is the reference."""
MESH_CURVES = ("P1", "P1-Fbar", "P2", REFERENCE)
SCATTER_CURVE = f"scatter ({REFERENCE})"
INCREMENT_CURVE, TOLERANCE_CURVE = f"increment ({REFERENCE})", "tolerance (P1-Fbar)"
DAMAGE_CURVE, GRIP_CURVE = "growth of f", "grips"


@dataclass(frozen=True)
class Study:
    """All rows of one study."""

    rows: tuple[Row, ...]

    @property
    def alloys(self) -> list[str]:
        """The alloys pulled, in their order."""
        return list({row.alloy: None for row in self.rows})

    @property
    def immersion(self) -> list[str]:
        """The immersion times pulled, rising."""
        return sorted({row.immersion for row in self.rows}, key=weeks)


def plan_pulls(alloys: Sequence[str], immersion: Sequence[str], long: bool = False) -> list[Pull]:
    """Every pull of the study; time zero is always among them."""
    times = list(dict.fromkeys(["0w", *immersion]))
    meshes = LONG_MESHES if long else MESHES
    pulls: list[Pull] = []
    for alloy in alloys:
        for element, sizes in meshes.items():
            for size in reversed(sizes):
                pulls += [_pull(element, alloy, t, element, size) for t in times]
        for size in NEARBY:
            pulls += [_pull(SCATTER_CURVE, alloy, t, REFERENCE, size) for t in times]
        base = [_pull("", alloy, t, REFERENCE, QUICK) for t in times]
        for x in LONG_INCREMENTS if long else INCREMENTS:
            change = {"curve": INCREMENT_CURVE, "choice": f"{100 * x:g} %", "increment": x}
            pulls += [replace(p, **change) for p in base]
        if long:
            pulls += _long_pulls(alloy, times)
    return pulls


def _long_pulls(alloy: str, times: Sequence[str]) -> list[Pull]:
    """Length held, tolerance and growth of f."""
    base = [_pull("", alloy, t, "P1-Fbar", QUICK) for t in times]
    pulls = [
        replace(p, curve=TOLERANCE_CURVE, choice=f"{x:g}", tolerance=x)
        for x in TOLERANCES
        for p in base
    ]
    for grip in GRIPS:
        text = "as in a run" if grip is None else f"{1e3 * grip:g} mm"
        base = [_pull(GRIP_CURVE, alloy, t, REFERENCE, QUICK) for t in times]
        pulls += [replace(p, choice=text, grip=grip) for p in base]
    for t in times[1:]:
        p = _pull(DAMAGE_CURVE, alloy, t, REFERENCE, COARSE)
        pulls += [
            replace(p, choice=f"{REFERENCE}, point"),
            replace(p, choice=f"{REFERENCE}, cell", damage="cell"),
        ]
        p = _pull(DAMAGE_CURVE, alloy, t, "P1-Fbar", QUICK)
        pulls.append(replace(p, choice="P1-Fbar, implicit", damage="implicit"))
    return pulls


def _pull(curve: str, alloy: str, immersion: str, element: str, size: tuple[float, float]) -> Pull:
    return Pull(
        curve, f"{1e3 * size[0]:g} mm", alloy, immersion, element, *size, increment=INCREMENT
    )


def study_tensile(
    alloys: Sequence[str],
    immersion: Sequence[str] = IMMERSION,
    tell: Callable[[str], None] = lambda line: None,
    long: bool = False,
    workers: int = 2,
    rows: Path | None = None,
    keep: Path | None = None,
) -> Study:
    """Run the study; `tell` hears a line per run; rows: a CSV that the rows go to as they come.

    keep: a folder in which fields, meshes and what each pull found stay, so that an interrupted
    study goes on.
    """
    pulls = plan_pulls(alloys, immersion, long)
    # A pull that stands on two curves is done once; the cheap ones first.
    once = list({_identity(p): p for p in pulls}.values())
    once.sort(key=_expected_work)
    found: dict[tuple, Row] = {}

    def done(row: Row) -> None:
        found[_identity(row)] = row
        tell(describe(row))
        if rows is not None:
            write_rows(_placed(pulls, found), rows)

    with kept_folder(keep) as place:
        shop = Workshop(place)
        for alloy in alloys:
            shop.corrode(alloy, list(dict.fromkeys(["0w", *immersion])))
        shop.pull(once, workers, done)
    return Study(tuple(_placed(pulls, found)))


def _identity(pull: Pull) -> tuple:
    return (pull.immersion, *pull.setting())


def _placed(pulls: Sequence[Pull], found: dict[tuple, Row]) -> list[Row]:
    """A row for every pull that is done, on its own curve."""
    return [
        replace(found[_identity(p)], curve=p.curve, choice=p.choice)
        for p in pulls
        if _identity(p) in found
    ]


def _expected_work(pull: Pull) -> float:
    """Grows with the seconds of a pull; only the order counts."""
    size = 0.5 * (pull.mesh_size + pull.mesh_size_fine)
    return (12.0 if pull.element.startswith("P2") else 1.0) * size**-4 / pull.increment


def describe(row: Row) -> str:
    """One line about a run."""
    return (
        f"{row.alloy} {row.immersion}, {row.element} on {row.cells:,} cells, {row.curve} "
        f"{row.choice}: {row.peak_force:.1f} N at {100 * row.strain_at_peak:.1f} %, "
        f"{row.processor_seconds:.1f} s, at most {row.iterations} iterations, {row.status}"
    )


# --- references and errors ----------------------------------------------------------------------


def limit_of(sizes: Sequence[float], values: Sequence[float]) -> tuple[float, float]:
    """Limit of a quantity as the mesh gets finer, and its uncertainty, both in its unit.

    sizes: edge lengths, coarse to fine; values: the quantity.  From the three finest, where they
    tend one way: Richardson's extrapolation with the observed order held between 1 and 2, and the
    distance of the limit from the finest value as uncertainty; else the finest value, and the
    spread of the three.
    """
    h, v = np.asarray(sizes, float)[-3:], np.asarray(values, float)[-3:]
    if len(v) < 2:
        return (float(v[-1]) if len(v) else float("nan")), float("nan")
    if len(v) == 2:
        return float(v[-1]), float(abs(v[1] - v[0]))
    first, second = v[1] - v[0], v[2] - v[1]
    if first * second <= 0.0 or abs(second) > abs(first):
        return float(v[-1]), float(np.ptp(v))
    orders = np.linspace(1.0, 2.0, 101)
    wanted = (h[0] ** orders - h[1] ** orders) / (h[1] ** orders - h[2] ** orders)
    order = float(orders[np.argmin(np.abs(wanted - first / second))])
    limit = v[2] + second * h[2] ** order / (h[1] ** order - h[2] ** order)
    return float(limit), float(abs(limit - v[2]))


def edge(row: Row) -> float:
    """Mean edge length of a mesh, up to a constant: cells to the power -1/3."""
    return float(row.cells) ** (-1.0 / 3.0)


class Errors:
    """Errors of the rows of one alloy: of the peak force, and of the strength left.

    force: reference and its uncertainty by immersion time (N); ratio: the same of the force over
    that of the intact screw with the same setting.
    """

    def __init__(self, study: Study, alloy: str) -> None:
        self.rows = [r for r in study.rows if r.alloy == alloy]
        self.times = study.immersion
        self.intact = {r.setting(): r.peak_force for r in self.rows if weeks(r.immersion) == 0.0}
        self.force: dict[str, tuple[float, float]] = {}
        self.ratio: dict[str, tuple[float, float]] = {}
        for t in self.times:
            curve = sorted(
                (r for r in self.rows if r.curve == REFERENCE and r.immersion == t and _ended(r)),
                key=lambda r: r.cells,
            )
            sizes = [edge(r) for r in curve]
            self.force[t] = limit_of(sizes, [r.peak_force for r in curve])
            known = [r for r in curve if np.isfinite(self.ratio_of(r))]
            self.ratio[t] = limit_of([edge(r) for r in known], [self.ratio_of(r) for r in known])

    def ratio_of(self, row: Row) -> float:
        """Peak force over that of the intact screw with the same setting, NaN where not known.

        Nothing is corroded in the intact screw: the growth of f does not matter to it.
        """
        plain = replace(row, damage=Pull.damage, damage_length=0.0, samples=Pull.samples)
        intact = self.intact.get(row.setting()) or self.intact.get(plain.setting())
        return row.peak_force / intact if intact else float("nan")

    def force_error(self, row: Row) -> float:
        """Relative error of the peak force against the reference."""
        return abs(row.peak_force / self.force[row.immersion][0] - 1.0)

    def ratio_error(self, row: Row) -> float:
        """Relative error of the strength left, with the uncertainty of the reference added."""
        reference, uncertainty = self.ratio[row.immersion]
        if weeks(row.immersion) == 0.0:
            return 0.0
        return abs(self.ratio_of(row) / reference - 1.0) + uncertainty / reference

    def curve(self, name: str, immersion: str) -> list[Row]:
        """Rows of one curve after one immersion time that ended as they should."""
        return [r for r in self.rows if r.curve == name and r.immersion == immersion and _ended(r)]

    def scatter(self, immersion: str) -> float:
        """Spread of the strength left, relative, on meshes of about one size; NaN from one."""
        near = self.curve(SCATTER_CURVE, immersion)
        sizes = [r.mesh_size for r in near]
        like = [
            r
            for r in self.curve(REFERENCE, immersion)
            if sizes and min(sizes) < r.mesh_size < max(sizes)
        ]
        ratios = [self.ratio_of(r) for r in (*near, *like)]
        return float(np.ptp(ratios) / np.mean(ratios)) if len(ratios) > 1 else float("nan")

    def increment_errors(self) -> dict[float, float]:
        """Error of the strength left by increment: extrapolated from the two finest at order 1."""
        found: dict[float, float] = {}
        for t in self.times:
            rows = sorted(self.curve(INCREMENT_CURVE, t), key=lambda r: -r.increment)
            if weeks(t) == 0.0 or len(rows) < 2:
                continue
            values = [self.ratio_of(r) for r in rows]
            exact = 2.0 * values[-1] - values[-2]
            for row, value in zip(rows, values, strict=True):
                error = abs(value / exact - 1.0)
                found[row.increment] = max(found.get(row.increment, 0.0), error)
        return found


def _ended(row: Row) -> bool:
    return not row.status.startswith("stopped")


@dataclass(frozen=True)
class Setting:
    """Mesh, element and increment with the errors and costs that follow, over all alloys and times.

    mesh_error, increment_error: of the strength left, relative, the doubt about its reference
    added; force_error: of the peak force against its reference, by the mesh;
    seconds: of the processor, of the longest test; measured: whether the pair was run itself, else
    its cost follows from the number of increments.
    """

    element: str
    mesh_size: float
    mesh_size_fine: float
    increment: float
    mesh_error: float
    increment_error: float
    force_error: float
    seconds: float
    total_seconds: float
    measured: bool

    @property
    def error(self) -> float:
        """Relative error of the strength left: that of the mesh plus that of the increment."""
        return self.mesh_error + self.increment_error

    @property
    def larger_error(self) -> float:
        """Larger relative error of strength left and peak force, that of the increment added."""
        return max(self.mesh_error, self.force_error) + self.increment_error


def error_parts(study: Study, chosen: Setting) -> dict[str, tuple[float, float]]:
    """By mesh and by increments, the errors of the strength left of a setting by alloy."""
    found = {}
    size = (chosen.element, chosen.mesh_size, chosen.mesh_size_fine)
    for alloy in study.alloys:
        errors = Errors(study, alloy)
        rows = [r for r in errors.rows if (r.curve, r.mesh_size, r.mesh_size_fine) == size]
        mesh = max(errors.ratio_error(r) for r in rows)
        found[alloy] = (float(mesh), float(errors.increment_errors()[chosen.increment]))
    return found


def settings(study: Study) -> list[Setting]:
    """Every mesh with every increment; meshes with a test that stopped are left out."""
    errors = {alloy: Errors(study, alloy) for alloy in study.alloys}
    increment = {
        x: max(e.increment_errors().get(x, np.inf) for e in errors.values())
        for x in {r.increment for r in study.rows if r.curve == INCREMENT_CURVE}
    }
    counts = {
        x: sum(r.increments for r in study.rows if (r.curve, r.increment) == (INCREMENT_CURVE, x))
        for x in increment
    }
    found = []
    meshes = {
        (r.curve, r.mesh_size, r.mesh_size_fine) for r in study.rows if r.curve in MESH_CURVES
    }
    for curve, size, fine in sorted(meshes):
        rows = [
            r for r in study.rows
            if (r.curve, r.mesh_size, r.mesh_size_fine) == (curve, size, fine)
        ]  # fmt: skip
        if len(rows) < len(study.alloys) * len(study.immersion) or not all(map(_ended, rows)):
            continue
        mesh = float(np.max([errors[r.alloy].ratio_error(r) for r in rows]))
        force = float(np.max([errors[r.alloy].force_error(r) for r in rows]))
        if not np.isfinite([mesh, force]).all():
            continue  # no reference at one of the times
        for x in sorted(increment, reverse=True):
            scale = counts[x] / counts[INCREMENT]
            found.append(
                Setting(
                    curve, size, fine, x, mesh, increment[x], force,
                    scale * max(r.processor_seconds for r in rows),
                    scale * sum(r.processor_seconds for r in rows), x == INCREMENT,
                )
            )  # fmt: skip
    return found


def cheapest(found: Sequence[Setting], wanted: float, most: float = np.inf) -> tuple[Setting, bool]:
    """The cheapest setting within an error of strength left and peak force; whether there is one.

    most: processor seconds that one test may take.  Where none is within the error: the one with
    the smallest error, or the cheapest within a tenth of it.
    """
    allowed = [s for s in found if s.seconds <= most] or list(found)
    least = min(s.larger_error for s in allowed)
    limit = wanted if least <= wanted else 1.1 * least
    good = [s for s in allowed if s.larger_error <= limit]
    return min(good, key=lambda s: s.seconds), least <= wanted
