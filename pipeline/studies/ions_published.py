"""The published features of the ions (Figs 3.26-3.29 and 5.8-5.10), found or not, and how large.

Each is looked for twice: with the numbers and equations as printed, and with the corrected ones
(`as_published` and the defaults of TransportOptions).  The source prints pictures without numbers,
so a feature is a sign or an order, and counts as found from a thousandth of the medium's value on.
What the source leaves open is assumed here: sodium makes the printed medium neutral (5.2.4), the
flux of 3.4.2 (1e-6 mol/m2/s of magnesium), and no mineral forms (with the nucleation indices of
the data none does).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import perilife_data
from peri.corrosion.kinetics import VolumeLossLaw
from peri.corrosion.scene import CorrosionScene
from peri.coupled.degradation import Degradation
from peri.engine.lattice import ball, box_lattice, cylinder
from peri.engine.march.marching import TimeStepping, march
from peri.transport.chemistry.species import Chemistry
from peri.transport.nernst_planck import TransportOptions
from pipeline.geometry.solids import ScrewParameters
from pipeline.studies.cases import screw_scene
from pipeline.studies.ions import FLUX, PAIRS, TOTALS, chemistry_of, medium_of, write_text

FILE = "nnpp_published.md"
DAY = 86400.0
NOTEWORTHY = 1e-3
SALINE = {"Na": 1000.0, "Cl": 1000.0}
"""mol/m3, section 3.4.2."""

AS_IONS = {**TOTALS["sbf"], "Na": 142.94}
"""Table 5.3 read as ions, with as much sodium as makes them neutral (printed: 142)."""

PRINTED = TransportOptions(flux_form="as_published", closure="as_published")
SETS = ("as printed", "corrected")


@dataclass(frozen=True)
class Feature:
    """A published feature; found : per set, whether it is there (None: open), and its size."""

    figure: str
    text: str
    found: dict[str, tuple[bool | None, str]]
    remark: str = ""


@dataclass(frozen=True)
class Picture:
    """The end of a march: fields on the lattice, what the medium holds, the first output.

    metal, near : (bool) at the end; near : liquid beside metal
    """

    problem: Degradation
    output: dict
    losses: np.ndarray
    metal: np.ndarray
    near: np.ndarray

    def change(self, species: str, where: np.ndarray | None = None) -> float:
        """Relative change against the medium, mean over nodes (default: beside the metal)."""
        k = self.problem.medium.chemistry.index(species)
        values = self.output["species"][k][self.near if where is None else where]
        return float(np.nanmean(values) / self.problem.medium.concentration[k, 0] - 1.0)

    def amount(self, species: str, where: np.ndarray) -> float:
        """Mean concentration, mol/m3."""
        k = self.problem.medium.chemistry.index(species)
        return float(np.nanmean(self.output["species"][k][where]))


def picture_of(scene: CorrosionScene, problem: Degradation, end: float) -> Picture:
    """March to the end and look at the liquid there."""
    done = march(problem, [0.0, end], TimeStepping(rate_change=0.1))
    last = done.outputs[-1]
    metal = np.asarray(last["metal"]).astype(bool)
    liquid = np.isfinite(np.asarray(last["ph"])) & ~metal
    shifted = np.zeros_like(metal)
    for axis in range(3):
        for step in (-1, 1):
            shifted |= np.roll(metal, step, axis)
    return Picture(problem, last, done.history["volume_loss"], metal, liquid & shifted)


# --- 1 M NaCl, section 3.4.2 --------------------------------------------------------------


def saline_scene(spacing: float) -> CorrosionScene:
    """The cylinder of 2.1 x 6.2 mm in a ball of 6 mm; horizon of two spacings."""
    lattice = box_lattice([-6e-3] * 3, [6e-3] * 3, spacing)
    return CorrosionScene(
        lattice,
        2 * spacing,
        cylinder(lattice, (0, 0, 0), 1.05e-3, 6.2e-3),
        ball(lattice, (0, 0, 0), 6e-3),
        solid_concentration=66082.4,
        saturation_concentration=0.6608,
        liquid_diffusivity=9.75e-10,
        dissolution_flux=FLUX,
        kinetics=VolumeLossLaw(0.2355),
    )


def saline_features(spacing: float = 0.4e-3, end: float = 26 * DAY) -> list[Feature]:
    """Figs 3.26 to 3.29."""
    found: dict[str, Picture] = {}
    scene = saline_scene(spacing)
    for name, reactions, options in (
        (SETS[0], "nacl-published", PRINTED),
        (SETS[1], "nacl", TransportOptions()),
    ):
        medium = medium_of(chemistry_of_saline(reactions), SALINE, "ideal")
        found[name] = picture_of(scene, Degradation(scene, medium, options), end)
    finer = Degradation(saline_scene(spacing / 1.5), found[SETS[1]].problem.medium)
    loss = march(finer, [end], TimeStepping(rate_change=0.1)).history["volume_loss"][-1]

    def each(what: Callable[[Picture], tuple[bool | None, str]]) -> dict:
        return {name: what(picture) for name, picture in found.items()}

    def spread(p: Picture) -> tuple[bool, str]:
        off = p.losses[-1] / loss - 1
        return abs(off) > 0.01, f"V_L {100 * p.losses[-1]:.2f} %, {100 * off:+.1f} %"

    def from_the_surface(p: Picture) -> tuple[bool, str]:
        left = p.output["concentration"] / p.problem.scene.solid_concentration
        inner = p.metal & ~_beside(~p.metal & p.problem.scene.domain)
        outer = p.metal & ~inner
        return bool(left[outer].mean() < left[inner].mean()), (
            f"{100 * left[outer].mean():.1f} % left at the surface, "
            f"{100 * left[inner].mean():.1f} % inside"
        )

    def layer(p: Picture) -> tuple[bool, str]:
        here, all_ = p.amount("MgOH", p.near), p.amount("MgOH", np.isfinite(p.output["ph"]))
        return here > (
            1 + NOTEWORTHY
        ) * all_, f"{here:.2g} beside it, {all_:.2g} mol/m3 in the mean"

    def potential(p: Picture) -> tuple[bool, str]:
        phi = np.where(p.metal, np.nan, p.output["potential"])
        largest = float(np.nanmax(np.abs(phi)))
        step = max(float(np.nanmax(np.abs(np.diff(phi, axis=a)))) for a in range(3))
        size = f"up to {1e3 * largest:.2g} mV, {100 * step / largest:.0f} % of it from node to node"
        return 0 < step < 0.5 * largest, size

    def spectators(p: Picture) -> tuple[bool, str]:
        # Shares of a thousandth of 1 M are seen in mol/m3, not in per cent.
        k = [p.problem.medium.chemistry.index(n) for n in ("Na", "Cl")]
        na, cl = (float(np.nanmean(p.output["species"][i][p.near])) - 1000.0 for i in k)
        return max(abs(na), abs(cl)) < 1.0, f"Na {na:+.3f}, Cl {cl:+.3f} mol/m3 beside it"

    return [
        Feature("3.26", "volume loss of the coarse lattice apart from that of the fine one",
                each(spread), "against 1.5 times finer; a grid of two spacings is not built"),
        Feature("3.27", "magnesium is lost from the surface", each(from_the_surface)),
        Feature("3.28", "a layer of MgOH+ round the metal", each(layer)),
        Feature("3.29", "potential smooth in the liquid", each(potential),
                "the printed colour bar is in volts; the printed conductivity leaves next to none"),
        Feature("text", "Na and Cl do not change", each(spectators),
                "they must: without them the liquid would not be neutral"),
    ]  # fmt: skip


def chemistry_of_saline(reactions: str) -> Chemistry:
    """The set at 25 degC, the temperature of section 3.4.2."""
    return Chemistry(perilife_data.load_reaction_set(reactions).at(298.15, ()))


def _beside(mask: np.ndarray) -> np.ndarray:
    out = np.zeros_like(mask)
    for axis in range(3):
        for step in (-1, 1):
            out |= np.roll(mask, step, axis)
    return out


# --- the screw in simulated body fluid, section 5.2.4 ---------------------------------------


def screw_features(end: float = 56 * DAY) -> list[Feature]:
    """Figs 5.8 to 5.10: the reference screw of Mg-5Gd at 100 um."""
    scene, screw = screw_scene("Mg-5Gd", 2, "complementarity"), ScrewParameters()
    found: dict[str, Picture] = {}
    corrected = TransportOptions()
    for name, reactions, totals, left_out, options in (
        (SETS[0], "sbf-published", AS_IONS, (), PRINTED),
        (SETS[1], "sbf", TOTALS["sbf"], (), corrected),
        ("corrected, no ion pairs", "sbf", TOTALS["sbf"], PAIRS, corrected),
    ):
        chemistry = chemistry_of(reactions, left_out=left_out)
        medium = medium_of(chemistry, totals, "ideal" if options is PRINTED else "fixed")
        found[name] = picture_of(scene, Degradation(scene, medium, options), end)
    x, y, z = scene.lattice.coordinates()
    radius = np.hypot(x, y)
    slot = (z > screw.length - screw.slot_depth) & (z < screw.length)
    slot = slot & (radius < 0.5 * screw.root_diameter)
    crest = (radius > 0.5 * screw.minor_diameter) & (z < screw.length - screw.slot_depth)

    def each(what: Callable[[Picture], tuple[bool | None, str]]) -> dict:
        return {name: what(picture) for name, picture in found.items()}

    def threads(p: Picture) -> tuple[bool, str]:
        left = p.output["concentration"] / p.problem.scene.solid_concentration
        shallow = p.problem.scene.metal & _beside(~p.problem.scene.metal)
        on, off = (float(1 - left[shallow & part].mean()) for part in (crest, ~crest))
        return on > off, f"{100 * on:.0f} % lost there, {100 * off:.0f} % of the other surface"

    def sign(species: str, wanted: int, in_slot: bool) -> Callable:
        def looked(p: Picture) -> tuple[bool, str]:
            where = (slot & ~p.metal & np.isfinite(p.output["ph"])) if in_slot else None
            change = p.change(species, where)
            return wanted * change > NOTEWORTHY, f"{100 * change:+.2f} %"

        return looked

    def rises(p: Picture) -> tuple[bool, str]:
        rise = float(np.mean(p.output["ph"][p.near])) - float(p.problem.medium.ph[0])
        return (
            rise > NOTEWORTHY,
            f"{rise:+.3f} beside it, medium {float(p.problem.medium.ph[0]):.3f}",
        )

    def settles(p: Picture) -> tuple[bool, str]:
        width = 0.5e-3
        relax = width**2 / (2 * float(p.problem.medium.chemistry.diffusivity.min()))
        return relax < 3600.0, f"within {relax:.0f} s over 0.5 mm"

    def loss(p: Picture) -> tuple[bool | None, str]:
        return None, f"V_L {100 * p.losses[-1]:.1f} %"

    pairs = "hangs on the ion pairs: MgHPO4 takes what else would accumulate"
    return [
        Feature("5.8", "volume loss agrees with the means of Mg-10Gd", each(loss),
                "no numbers in the text; here the law of Mg-5Gd"),
        Feature("5.9", "pH rises towards the metal", each(rises),
                "the text calls its rise smaller than the experiments' and prints no numbers"),
        Feature("5.10a", "corrosion is fastest on the threads", each(threads)),
        Feature("5.10b", "H+ is depleted beside the metal", each(sign("H", -1, False))),
        Feature("5.10c", "HCO3- is raised in the slot", each(sign("HCO3", 1, True))),
        Feature("5.10d", "HPO4(2-) accumulates in the slot", each(sign("HPO4", 1, True)), pairs),
        Feature("text", "the other ions settle quickly", each(settles)),
    ]  # fmt: skip


# --- told ---------------------------------------------------------------------------------


def lines_of(features: list[Feature]) -> list[str]:
    """The features as Markdown, one column per set."""
    names = list(features[0].found)
    lines = [f"| figure | feature | {' | '.join(names)} | remark |"]
    lines.append("|" + " --- |" * (len(names) + 3))
    words = {True: "found", False: "not found", None: "not decidable"}
    for feature in features:
        cells = [f"**{words[is_]}**: {size}" for is_, size in feature.found.values()]
        lines.append(
            f"| {feature.figure} | {feature.text} | {' | '.join(cells)} | {feature.remark} |"
        )
    return lines


def print_published_ions(out: Path | None) -> None:
    """Look for every feature, print the two tables, and write them into a folder if given."""
    saline, screw = saline_features(), screw_features()
    text = "\n".join(
        [
            "1 M NaCl, 26 days, cylinder in a ball of 6 mm (section 3.4.2):", "",
            *lines_of(saline), "",
            "Simulated body fluid, 56 days, the reference screw (section 5.2.4):", "",
            *lines_of(screw), "",
        ]
    )  # fmt: skip
    print(text)
    write_text(
        out, FILE, "# The published features of the ions", "perilife study nnpp --published", text
    )
