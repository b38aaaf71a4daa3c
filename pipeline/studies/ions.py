"""Error against run time of the ions' stage: what each numerical and chemical choice costs.

Columns: magnesium dissolves at a given flux into half a millimetre of medium between metal and
refreshed liquid; what is compared is the pH beside the metal, against the limit of no spacing
(two lattices extrapolated; the error there is first order).  Bodies: a ball of metal in a ball of
medium for two weeks, with minerals that do form; compared with far shorter steps.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import perilife_data
from peri.corrosion.kinetics import VolumeLossLaw
from peri.corrosion.scene import CorrosionScene
from peri.coupled.degradation import Degradation
from peri.coupled.surroundings import MAGNESIUM
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import ball, box_lattice
from peri.engine.march.marching import TimeStepping, march
from peri.transport.chemistry.speciation import Solution, speciate
from peri.transport.chemistry.species import Chemistry
from peri.transport.liquid import LiquidSpace, LiquidState
from peri.transport.nernst_planck import QuasiSteadyLiquid, TransportOptions
from pipeline.record.whole_file import whole_file

FILE = "nnpp.md"
HOUR, DAY = 3600.0, 86400.0
LENGTH = 0.5e-3
FLUX, STRONG = 1e-6, 1e-5
"""mol/m2/s: that of an implant at first (Table 5.1), and one at which brucite forms in saline."""

TOTALS = {
    "sbf": {"HCO3": 34.88, "HPO4": 1.39, "Ca": 2.31, "Na": 142.0, "Cl": 109.9},
    "nacl": {"Na": 142.0, "Cl": 142.0},
}
"""mol/m3: Table 5.3 of the dissertation as totals, and saline of as much sodium."""

PAIRS = (
    "MgOH", "MgHCO3", "MgCO3", "MgHPO4", "MgPO4", "CaHCO3",
    "CaCO3", "CaHPO4", "CaPO4", "NaHCO3", "NaCO3", "NaHPO4",
)  # fmt: skip
GROWING = {"calcite": 1.0, "hydroxyapatite": 8.0}
"""Nucleation indices at which minerals form beside the metal (those of the set are higher)."""

USED = TransportOptions()
"""What a run does."""

SPACINGS = (20, 40, 80, 160, 320)
HORIZONS = (1, 2, 3, 4, 6)
STEPS = (48 * HOUR, 24 * HOUR, 12 * HOUR, 3 * HOUR, HOUR)
CHANGES = (0.2, 0.1, 0.05, 0.025)
SPLIT_STEPS = (1000.0, 3 * HOUR, 24 * HOUR)
END = 14 * DAY


@dataclass(frozen=True)
class Row:
    """One choice: what it gives, how far off that is, and its processor time, s.

    values, errors : by quantity; default : whether it is what a run does.
    """

    choice: str
    values: dict[str, float]
    errors: dict[str, float]
    seconds: float
    default: bool = False


@dataclass(frozen=True)
class Table:
    """Rows about one choice."""

    title: str
    rows: tuple[Row, ...]


# --- chemistry and columns ----------------------------------------------------------------


def chemistry_of(
    name: str, minerals: Sequence[str] = (), left_out: Sequence[str] = (), spread: float = 1.0
) -> Chemistry:
    """A shipped set at 37 degC (25 degC where it knows no other), some of it changed.

    left_out : formed species to do without; spread : factor on all diffusivities but that of Mg.
    """
    loaded = perilife_data.load_reaction_set(name)
    warm = 310.15 in loaded.species["H"].diffusivity
    numbers = loaded.at(310.15 if warm else 298.15, tuple(minerals))
    kept = {
        field: {n: v for n, v in getattr(numbers, field).items() if n not in left_out}
        for field in ("charge_number", "diffusivity", "stoichiometry", "water", "log_k")
    }
    kept["diffusivity"] = {
        n: d if n == "Mg" else spread * d for n, d in kept["diffusivity"].items()
    }
    changed = {
        n: dataclasses.replace(m, nucleation_index=GROWING.get(n, m.nucleation_index))
        for n, m in numbers.minerals.items()
    }
    return Chemistry(dataclasses.replace(numbers, minerals=changed, **kept))


def medium_of(chemistry: Chemistry, totals: dict[str, float], activity: str) -> Solution:
    """The medium; "fixed" means Davies at its own ionic strength."""
    law = "davies" if activity == "fixed" else activity
    return speciate(chemistry, chemistry.totals(totals), law)


def column(
    medium: Solution, nodes: int = 160, ratio: int = 3, **options
) -> tuple[QuasiSteadyLiquid, np.ndarray]:
    """Half a millimetre of medium beside metal; and the source of a unit flux, 1/m."""
    spacing = LENGTH / nodes
    lattice = box_lattice([0.0], [(nodes + ratio) * spacing], spacing)
    held = np.arange(nodes + ratio) >= nodes
    space = LiquidSpace(diffusion_stencil(lattice, ratio * spacing), np.ones_like(held), held)
    surface = np.arange(nodes) == 0
    liquid = QuasiSteadyLiquid(space, medium, MAGNESIUM, surface, TransportOptions(**options))
    return liquid, surface / spacing


def magnesium(liquid: QuasiSteadyLiquid, state: LiquidState) -> np.ndarray:
    """Total magnesium, mol/m3, (n,)."""
    e = liquid.chemistry.components.index("Mg")
    return liquid.chemistry.stoichiometry[:, e] @ state.concentration


@dataclass(frozen=True)
class _Found:
    ph: float
    magnesium: float
    millivolt: float
    seconds: float


def _beside(medium: Solution, flux: float = FLUX, **how) -> _Found:
    """What is found beside the metal of a column, timed at its second solution."""
    liquid, unit = column(medium, **how)
    liquid.solve(flux * unit)
    begun = time.process_time()
    state = liquid.solve(flux * unit)
    seconds = time.process_time() - begun
    return _Found(
        float(liquid.ph(state)[0]),
        float(magnesium(liquid, state)[0]),
        1e3 * liquid.thermal_voltage * float(state.psi[0]),
        seconds,
    )


def _limit(medium: Solution, flux: float = FLUX, **how) -> _Found:
    """The same for spacing zero, from the two finest lattices."""
    coarse, fine = (_beside(medium, flux, nodes=n, **how) for n in SPACINGS[-2:])
    return _Found(
        2 * fine.ph - coarse.ph,
        2 * fine.magnesium - coarse.magnesium,
        2 * fine.millivolt - coarse.millivolt,
        fine.seconds,
    )


def _row(choice: str, found: _Found, exact: _Found, default: bool = False) -> Row:
    return Row(
        choice,
        {"pH": found.ph, "Mg, mol/m3": found.magnesium, "phi, mV": found.millivolt},
        {"pH": found.ph - exact.ph, "Mg": found.magnesium / exact.magnesium - 1.0},
        found.seconds,
        default,
    )


def lattice_tables() -> list[Table]:
    """Spacing at three spacings a horizon, and spacings a horizon at 160 nodes."""
    medium = medium_of(chemistry_of("sbf"), TOTALS["sbf"], "fixed")
    exact = _limit(medium)
    spacing = [_row(f"{1e6 * LENGTH / n:g} um", _beside(medium, nodes=n), exact) for n in SPACINGS]
    horizon = [
        _row(f"{m} spacings of {1e6 * LENGTH / 160:g} um", _beside(medium, ratio=m), exact)
        for m in HORIZONS
    ]
    return [
        Table("Spacing (horizon of three)", tuple(spacing)),
        Table("Horizon", tuple(horizon)),
    ]


def transport_tables() -> list[Table]:
    """Forms of the bond flux in saline at a strong release, and closures in both media."""
    tables = []
    saline = medium_of(chemistry_of("nacl", left_out=("MgOH",)), TOTALS["nacl"], "fixed")
    exact = _beside(saline, STRONG, flux_form="sg")
    rows = [
        _row(form, _beside(saline, STRONG, flux_form=form), exact, form == USED.flux_form)
        for form in ("sg", "sqra", "mean", "as_published")
    ]
    tables.append(Table(f"Bond flux, saline, {STRONG:g} mol/m2/s, against sg", tuple(rows)))
    for name in ("sbf", "nacl"):
        medium = medium_of(chemistry_of(name), TOTALS[name], "fixed")
        exact = _beside(medium)
        rows = [
            _row(closure, _beside(medium, closure=closure), exact, closure == USED.closure)
            for closure in ("electroneutral", "poisson", "none", "as_published")
        ]
        tables.append(Table(f"Closure, {name}, {FLUX:g} mol/m2/s", tuple(rows)))
    return tables


def chemistry_tables() -> list[Table]:
    """Activities, ion pairs and the spread of the diffusivities, in simulated body fluid."""
    plain, totals = chemistry_of("sbf"), TOTALS["sbf"]
    medium = medium_of(plain, totals, "fixed")
    exact = _beside(medium)
    liquid, unit = column(medium)
    state = liquid.solve(FLUX * unit)
    inside = plain.stoichiometry.T @ state.concentration[:, :1]
    begun = time.process_time()
    own = speciate(plain, inside, "davies", start=state.ln_component[:, :1].copy())
    own_found = dataclasses.replace(exact, ph=float(own.ph[0]), seconds=time.process_time() - begun)
    rows = [
        _row("fixed: Davies at the medium's ionic strength", exact, exact, True),
        _row("davies: the same totals at their own ionic strength", own_found, exact),
        *(_row(n, _beside(medium_of(plain, totals, n)), exact) for n in ("wateq", "ideal")),
    ]
    tables = [Table("Activity, sbf", tuple(rows))]
    bare = medium_of(chemistry_of("sbf", left_out=PAIRS), totals, "fixed")
    rows = [
        _row("with twelve ion pairs", exact, exact, True),
        _row("without", _beside(bare), exact),
    ]
    tables.append(Table("Ion pairs, sbf", tuple(rows)))
    rows = [_row("as in the set", exact, exact, True)]
    for factor in (0.95, 1.05):
        other = medium_of(chemistry_of("sbf", spread=factor), totals, "fixed")
        rows.append(_row(f"times {factor:g}, all but Mg", _beside(other), exact))
    tables.append(Table("Diffusivities at 37 degC (known to 5 %)", tuple(rows)))
    return tables


def solubility_table() -> Table:
    """Saturation index of apatite in the medium at rest, by the constant that is taken."""
    rows = []
    medium = medium_of(chemistry_of("sbf", ("hydroxyapatite",)), TOTALS["sbf"], "fixed")
    index = float(medium.saturation_index[0, 0])
    for name, product in (
        ("phreeqc.dat (54.80)", 54.80),
        ("measured, 58.6", 58.6),
        ("measured, 59.4", 59.4),
    ):
        found = index + product - 54.80
        rows.append(Row(name, {"index": found}, {"index": found - index}, 0.0, product == 54.80))
    return Table("Solubility product of hydroxyapatite, -log10 as 5 Ca + 3 PO4 + OH", tuple(rows))


# --- splitting ----------------------------------------------------------------------------


def splitting_table(steps: Sequence[float] = SPLIT_STEPS) -> Table:
    """Share of the released magnesium that becomes brucite, joined and one after the other.

    One after the other: transport without minerals (at rest: the steps are longer than it takes
    to relax), then at every node what is dissolved there precipitates to saturation.
    """
    chem = chemistry_of("nacl", ("brucite",), ("MgOH",))
    medium = medium_of(chem, TOTALS["nacl"], "fixed")
    liquid, unit = column(medium, 80, closure="none")
    released = liquid.space.total(STRONG * unit)
    begun = time.process_time()
    state = liquid.solve(STRONG * unit)
    joined = liquid.space.total(state.rates[0]) / released
    rows = [Row("joined, any step", {"share": joined}, {"share": 0.0},
                time.process_time() - begun, True)]  # fmt: skip
    for step in steps:
        begun = time.process_time()
        state = liquid.solve(STRONG * unit, minerals=False)
        # As transport left them: H made up from neutrality would bring OH that has diffused away.
        inside = chem.stoichiometry.T @ state.concentration
        formed = speciate(
            chem, inside, "fixed", strength=float(medium.strength[0]), minerals=("brucite",),
            start=state.ln_component.copy(),
        )  # fmt: skip
        share = liquid.space.total(formed.mineral[0]) / (step * released)
        rows.append(
            Row(
                f"one after the other, {step:g} s",
                {"share": share},
                {"share": share - joined},
                time.process_time() - begun,
            )
        )
    return Table(f"Splitting: brucite in saline at {STRONG:g} mol/m2/s", tuple(rows))


# --- bodies -------------------------------------------------------------------------------


def body_scene(spacing: float = 0.1e-3, flux: float = FLUX) -> CorrosionScene:
    """A ball of metal of 0.3 mm in a ball of medium of 0.9 mm, horizon of two spacings."""
    lattice = box_lattice([-0.9e-3] * 3, [0.9e-3] * 3, spacing)
    return CorrosionScene(
        lattice,
        0.2e-3,
        ball(lattice, (0, 0, 0), 0.3e-3),
        ball(lattice, (0, 0, 0), 0.9e-3),
        solid_concentration=66082.4,
        saturation_concentration=0.6608,
        liquid_diffusivity=8.6822e-9,
        dissolution_flux=flux,
        kinetics=VolumeLossLaw(0.2355),
    )


def _march(stepping: TimeStepping, end: float) -> dict[str, float]:
    chem = chemistry_of("sbf", ("brucite", "calcite", "hydroxyapatite"))
    medium = medium_of(chem, TOTALS["sbf"], "fixed")
    problem = Degradation(body_scene(), medium, TransportOptions(closure="none"), minerals=True)
    begun = time.process_time()
    done = march(problem, [end], stepping)
    return {
        "V_L": float(done.history["volume_loss"][-1]),
        "pH": float(done.history["highest_ph"][-1]),
        "calcite": float(done.history["calcite_amount"][-1]),
        "apatite": float(done.history["hydroxyapatite_amount"][-1]),
        "steps": float(done.history["time"].size - 1),
        "seconds": time.process_time() - begun,
    }


def step_table(
    steps: Sequence[float] = STEPS, changes: Sequence[float] = CHANGES, end: float = END,
    say: Callable[[str], None] = print,
) -> Table:  # fmt: skip
    """Fixed and controlled steps, against controlled ones of an eighth of the smallest change."""
    exact = _march(TimeStepping(rate_change=min(changes) / 4), end)
    choices = [
        (f"backward Euler, {s / HOUR:g} h", TimeStepping("backward_euler", step=s)) for s in steps
    ]
    choices += [(f"SDIRK2, {s / HOUR:g} h", TimeStepping(step=s)) for s in steps[:3]]
    choices += [(f"SDIRK2, change {c:g}", TimeStepping(rate_change=c)) for c in changes]
    rows = []
    for name, stepping in choices:
        found = _march(stepping, end)
        errors = {n: found[n] / exact[n] - 1 for n in ("V_L", "calcite", "apatite")}
        errors["pH"] = found["pH"] - exact["pH"]
        rows.append(
            Row(name, {"steps": found["steps"]}, errors, found["seconds"], name.endswith(" 0.1"))
        )
        say(name)
    return Table(f"Steps: a ball in sbf, three minerals, {end / DAY:g} days", tuple(rows))


# --- all of it ----------------------------------------------------------------------------


def study_ions(say: Callable[[str], None]) -> list[Table]:
    """Every table of the study."""
    tables = [*lattice_tables(), *transport_tables(), *chemistry_tables(), solubility_table()]
    say("columns done")
    tables.append(splitting_table())
    tables.append(step_table(say=say))
    return tables


def lines_of(table: Table) -> list[str]:
    """A table as Markdown."""
    first = table.rows[0]
    heads = ["choice", *first.values, *(f"error of {n}" for n in first.errors), "processor ms"]
    lines = [f"**{table.title}**", "", f"| {' | '.join(heads)} |"]
    lines.append("| --- |" + " ---: |" * (len(heads) - 1))
    for row in table.rows:
        cells = [f"{v:.5g}" for v in row.values.values()]
        cells += [f"{v:+.1e}" for v in row.errors.values()]
        cells.append(f"{1e3 * row.seconds:.0f}")
        name = f"{row.choice} (default)" if row.default else row.choice
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return [*lines, ""]


def print_ions(out: Path | None) -> None:
    """Run the study, print its tables, and write them into a folder where one is given."""
    tables = study_ions(lambda text: print(text, flush=True))
    text = "\n".join(line for table in tables for line in lines_of(table))
    print("\n" + text)
    write_text(out, FILE, "# Ions: error against run time", "perilife study nnpp", text)


def write_text(out: Path | None, name: str, title: str, command: str, text: str) -> None:
    """A Markdown file in a folder, complete or not at all; nothing without a folder."""
    if out is None:
        return
    path = out / name
    page = f"{title}\n\nWritten by `{command} --out {out.name}`.\n\n{text}"
    with whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    print(path)
