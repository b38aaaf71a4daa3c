"""The report's section on ions, pH and minerals, from what the corrosion stage recorded."""

from pathlib import Path

from markupsafe import Markup

from pipeline.record.run_folder import RunFolder
from pipeline.record.run_results import AlloyResult, RunResults
from pipeline.report import plots
from pipeline.report.ion_maps import IONS_FILE, ion_maps
from pipeline.report.wording import duration, percent

SHOWN = ("Mg", "H", "HCO3", "HPO4", "Ca")
"""Species whose amount beside the metal is listed, where the medium knows them."""

_FEATURES = (
    ("H", -1, "hydrogen ions are depleted beside the metal"),
    ("HCO3", 1, "hydrogen carbonate accumulates beside the metal"),
    ("HPO4", 1, "hydrogen phosphate accumulates beside the metal"),
)
"""What the source shows of SBF after eight weeks (Fig. 5.10): species, sign of change, in words."""

_NOTEWORTHY = 2e-3
"""Relative change below which a published feature counts as not found."""


def ion_section(run: RunResults) -> dict[str, object]:
    """What the template shows; empty where the run followed no ions."""
    told = [(a, a.corrosion_numbers["ions"]) for a in run.alloys if "ions" in a.corrosion_numbers]
    if not told:
        return {}
    first = told[0][1]
    return {
        "title": first["title"],
        "temperature": f"{first['temperature'] - 273.15:g} °C",
        "ph": f"{first['ph']:.3f}",
        "strength": f"{first['strength']:.3f}",
        "reactions": first["reactions"],
        "bath": first.get("bath", ""),
        "feedback": first.get("feedback", ""),
        "electrodes": first.get("electrodes", ""),
        "closure": first["closure"],
        "flux_form": first["flux_form"],
        "species": [n for n in SHOWN if n in first["concentrations"]],
        "alloys": [
            {
                "name": alloy.name,
                "followed": numbers["followed"],
                "reads": any(_both(row) for row in numbers["rows"]),
                "potential": any(r.get("metal_potential") is not None for r in numbers["rows"]),
                "rows": [_row(row, first) for row in numbers["rows"]],
                "plot": Markup(plots.ph_plot(alloy.name, f"{n}", numbers["rows"], numbers["ph"])),
                "maps": Markup(ion_maps(_file(run, alloy.name), alloy.name, f"{n}")),
                "features": _features(alloy, numbers),
            }
            for n, (alloy, numbers) in enumerate(told)
        ],
    }


def _both(row: dict) -> str:
    """Volume loss, and that of the law of the scene by itself, where the metal reads the liquid."""
    if row.get("volume_loss_alone") is None:
        return ""
    return f"{percent(row['volume_loss'], 2)} ({percent(row['volume_loss_alone'], 2)})"


def _file(run: RunResults, alloy: str) -> Path:
    return RunFolder(run.folder).corrosion(alloy) / IONS_FILE


def _row(row: dict, medium: dict) -> dict[str, object]:
    beside = row["ph_beside_metal"]
    return {
        "time": duration(row["time"]),
        "highest": f"{row['highest_ph']:.3f}",
        "bath": f"{row['bath_ph']:.3f}" if row.get("bath_ph") is not None else "",
        "beside": "–" if beside is None else f"{beside:.3f}",
        "potential": f"{1e3 * row['largest_potential']:.3f}",
        "hydrogen": f"{row['hydrogen_ml_per_cm2']:.2f}",
        "magnesium": f"{1e6 * row.get('released_mol', row['hydrogen_mol']):.3g}",
        "alone": _both(row),
        "metal": f"{row['metal_potential']:.4f}" if row.get("metal_potential") is not None else "",
        "minerals": ", ".join(
            f"{name} {1e6 * found['amount_mol']:.2g}"
            for name, found in row["minerals"].items()
            if found["amount_mol"] > 0
        )
        or "none",
        "balance": f"{row['balance']:.0e}",
        "charge": f"{row['net_charge']:.0e}",
        "lowest": f"{row['lowest']:.2g}",
        "fullest": percent(row.get("fullest", 0.0)),
        "beside_metal": [
            f"{row['beside_metal'][n]:.4g}" if n in row["beside_metal"] else "–"
            for n in SHOWN
            if n in medium["concentrations"]
        ],
    }


def _features(alloy: AlloyResult, numbers: dict) -> list[str]:
    """The published features, one by one, as found or not, from the last time."""
    rows, medium = numbers["rows"], numbers["concentrations"]
    last = rows[-1]
    if not last["beside_metal"] or last["ph_beside_metal"] is None:
        return []
    rise = last["ph_beside_metal"] - numbers["ph"]
    found = ["found" if rise > 1e-3 else "not found"]
    sentences = [f"pH rises towards the metal (Fig. 5.9): {found[0]}, by {rise:+.3f} beside it."]
    for name, sign, words in _FEATURES:
        if not medium.get(name):
            continue
        change = last["beside_metal"][name] / medium[name] - 1.0
        there = "found" if sign * change > _NOTEWORTHY else "not found"
        sentences.append(f"In SBF, {words} (Fig. 5.10): {there}, {percent(change, 1)} beside it.")
    return sentences
