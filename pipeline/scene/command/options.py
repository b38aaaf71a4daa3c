"""Command-line options that describe a scene, and how they become one."""

import argparse
import dataclasses
import math
from pathlib import Path

from peri.engine.omission import DEFAULT_TOLERANCE
from pipeline.scene.classes import read_classes
from pipeline.scene.holding import ALL as HOLDS
from pipeline.scene.image import ImageFile, add_image_options, content_of, image_from_options
from pipeline.scene.laws.coating import read_coating
from pipeline.scene.laws.electrodes import BALANCES, NUMBERS, read_electrodes
from pipeline.scene.laws.feedback import read_feedback
from pipeline.scene.laws.ions import (
    ACTIVITIES,
    CLOSURES,
    DEFAULT_MEDIUM,
    DEFAULT_MINERALS,
    FLUX_FORMS,
    MODELS,
    IonSettings,
    resolve_ions,
)
from pipeline.scene.laws.rate_law import kinetics_in_words
from pipeline.scene.loads import LOADS
from pipeline.scene.mechanics import DAMAGE_UPDATES, ELEMENTS, LATERAL, MAPPINGS
from pipeline.scene.resolution import RESOLUTIONS
from pipeline.scene.scene import (
    BOUNDARIES,
    CALIBRATIONS,
    DISSOLUTION_LAWS,
    DOMAIN_SHAPES,
    OMITTABLE,
    SATURATIONS,
    TIME_SCHEMES,
    DomainSettings,
    Geometry,
    Scene,
    ScrewGeometry,
    SolidFile,
)
from pipeline.scene.screw import THREADS, ScrewParameters
from pipeline.scene.units import (
    METRES_PER,
    parse_angle,
    parse_length,
    parse_time,
    parse_volume,
)

_SCREW_LENGTHS = {
    "diameter": "of the thread, outer (2mm)",
    "length": "from end face to end face (4mm)",
    "pitch": "of the thread (0.4mm)",
    "slot_width": "of the slot for the driver (0.5mm; 0mm with depth 0mm: none)",
    "slot_depth": "of the slot (0.5mm)",
}


def add_scene_options(parser: argparse.ArgumentParser, immersion: bool = True) -> None:
    """Add every option from which `scene_from_options` builds the scene.

    immersion: whether times are asked for; a caller that does not ask sets them.
    """
    parser.add_argument(
        "--alloy", nargs="+", required=True, metavar="A", help="alloy name, or TOML file of one"
    )
    if immersion:
        parser.add_argument(
            "--immersion", nargs="+", required=True, metavar="T", help="rising times: 8w, 56d, 36h"
        )
    parser.add_argument(
        "--resolution",
        default="quick",
        metavar="R",
        help=f"preset of accuracy and run time: {', '.join(RESOLUTIONS)} (quick)",
    )
    parser.add_argument(
        "--parameters",
        metavar="SET",
        help="parameter set, or TOML file of one (the alloy's own, else table-5.1)",
    )
    parser.add_argument(
        "--volume-loss",
        action="append",
        default=[],
        metavar="ALLOY=FILE",
        help="measured volume loss (CSV), plotted beside the result; may be repeated",
    )
    screw = parser.add_argument_group("geometry (lengths with unit: 2mm, 100um)")
    for name, text in _SCREW_LENGTHS.items():
        screw.add_argument(f"--{name.replace('_', '-')}", metavar="LENGTH", help=text)
    screw.add_argument("--thread", metavar="KIND", help=f"{', '.join(THREADS)} ({THREADS[0]})")
    screw.add_argument("--solid", metavar="FILE", help="closed solid instead: STEP, BREP or STL")
    screw.add_argument("--unit", metavar="U", help=f"of the solid: {', '.join(METRES_PER)} (mm)")
    add_image_options(screw)
    corrosion = parser.add_argument_group("corrosion, in place of the preset (--resolution)")
    corrosion.add_argument(
        "--spacing",
        metavar="LENGTH",
        help="lattice spacing (preset); auto: the preset's, or finer where the solid needs it",
    )
    corrosion.add_argument(
        "--horizon",
        metavar="LENGTH",
        help="how far metal exchanges matter with the liquid (preset: 200um); the grips hold that "
        "much more, too",
    )
    corrosion.add_argument(
        "--step",
        metavar="TIME",
        help="fixed time step, at most the longest immersion time (controlled); shortened where "
        "rate classes dissolve",
    )
    corrosion.add_argument(
        "--rate-change",
        type=float,
        metavar="X",
        help="step control: of a rate in a step (preset)",
    )
    corrosion.add_argument(
        "--scheme", metavar="S", help=f"of the time steps: {', '.join(TIME_SCHEMES)} (sdirk2)"
    )
    corrosion.add_argument(
        "--saturation",
        metavar="S",
        help=f"of the liquid at C_sat: {', '.join(SATURATIONS)} (complementarity)",
    )
    corrosion.add_argument(
        "--kinetics",
        metavar="LAW",
        help=f"of the rate, with its numbers (SI, ? may be left out): {kinetics_in_words()}; "
        "as tafel:overpotential=0.02,slope=0.1 (volume_loss, l from the parameter set)",
    )
    corrosion.add_argument(
        "--coating",
        metavar="LAW",
        help="multiplies the rate for a time: factor=0.1,lifetime=28d (none; always assumed)",
    )
    corrosion.add_argument(
        "--dissolution",
        metavar="LAW",
        help=f"of a bond: {', '.join(DISSOLUTION_LAWS)} (proportional, as published)",
    )
    corrosion.add_argument(
        "--calibration",
        metavar="C",
        help=f"of diffusion on the lattice: {', '.join(CALIBRATIONS)} (discrete)",
    )
    corrosion.add_argument(
        "--classes",
        metavar="P",
        help="rate classes per cell near the surface, which remove most of the lattice's error; "
        "0: one rate per node (auto: 3 where the scene allows them)",
    )
    corrosion.add_argument(
        "--tolerance",
        type=float,
        metavar="X",
        help="of V_L, within which the march leaves out what it does not need "
        f"({DEFAULT_TOLERANCE:g})",
    )
    corrosion.add_argument(
        "--keep",
        nargs="+",
        metavar="WHAT",
        help="compute all the same, of what `perilife plan` lists as left out: "
        + ", ".join(OMITTABLE),
    )
    corrosion.add_argument(
        "--domain", metavar="SHAPE", help=f"of the liquid: {', '.join(DOMAIN_SHAPES)} (cylinder)"
    )
    corrosion.add_argument(
        "--boundary",
        metavar="B",
        help=f"edge of the liquid: {', '.join(BOUNDARIES)} (the parameter set's)",
    )
    corrosion.add_argument(
        "--radial-margin", metavar="LENGTH", help="liquid beside the solid (0.5mm)"
    )
    corrosion.add_argument(
        "--axial-margin", metavar="LENGTH", help="liquid above and below it (0.4mm)"
    )
    ions = parser.add_argument_group("ions, pH and minerals (with --model nnpp)")
    ions.add_argument(
        "--model",
        default=MODELS[0],
        choices=MODELS,
        help="nnpp: bi-material metal, and the ions of the medium around it (bi-material)",
    )
    ions.add_argument("--medium", metavar="M", help=f"name, or TOML file ({DEFAULT_MEDIUM})")
    ions.add_argument(
        "--minerals", nargs="*", metavar="M", help=f"may form ({', '.join(DEFAULT_MINERALS)})"
    )
    ions.add_argument("--activity", metavar="A", help=", ".join(ACTIVITIES))
    ions.add_argument("--flux-form", metavar="F", help=f"{', '.join(FLUX_FORMS)} (sqra)")
    ions.add_argument("--closure", metavar="C", help=f"{', '.join(CLOSURES)} (electroneutral)")
    ions.add_argument(
        "--bath-volume", metavar="VOLUME", help="of the stirred medium, 50mL (it never changes)"
    )
    ions.add_argument("--exchange-every", metavar="T", help="time between fresh baths, 2d (never)")
    ions.add_argument("--open-to", nargs="+", metavar="GAS", help="of the bath: CO2 (closed)")
    ions.add_argument(
        "--feedback",
        metavar="F",
        help="of the liquid on the metal: ph_order=0.3,layer_thickness=1e-5 (none; assumed)",
    )
    ions.add_argument(
        "--electrodes",
        metavar="E",
        help="anode and cathode in the place of --kinetics: "
        f"balance={'|'.join(BALANCES)} and {', '.join(NUMBERS)} (none; assumed)",
    )
    ions.add_argument("--balance", metavar="ION", help="its amount as neutrality wants it")
    tensile = parser.add_argument_group("tensile test, in place of the preset (--resolution)")
    tensile.add_argument(
        "--load",
        metavar="L",
        help=f"{', '.join(LOADS)} (axial): the top grip is pulled, twisted or bent",
    )
    tensile.add_argument(
        "--bending-azimuth", metavar="ANGLE", help="of the axis of bending from x, as 30deg (0deg)"
    )
    tensile.add_argument(
        "--hardening",
        nargs="+",
        metavar="NAME",
        help="another record of an alloy's hardening (`perilife alloys`), or TOML file of one",
    )
    tensile.add_argument(
        "--mesh-size", metavar="LENGTH", help="edge length of the cells in the bulk (preset)"
    )
    tensile.add_argument(
        "--mesh-size-fine", metavar="LENGTH", help="the same at thread and slot (preset)"
    )
    tensile.add_argument(
        "--mesh-size-faces", metavar="LENGTH", help="at end faces that are pulled (50um)"
    )
    tensile.add_argument("--element", metavar="E", help=f"{', '.join(ELEMENTS)} (P2-Fbar)")
    tensile.add_argument(
        "--hold",
        nargs="+",
        default=[],
        metavar="H",
        help=f"ways of holding it: {', '.join(HOLDS)}, all (shank: both ends, below what corrodes)",
    )
    tensile.add_argument("--bottom-grip", metavar="LENGTH", help="held at the bottom (as the top)")
    tensile.add_argument(
        "--top-grip", metavar="LENGTH", help="held at the top (slot and horizon; 0mm: end face)"
    )
    tensile.add_argument(
        "--lateral",
        metavar="L",
        help=f"grips leave sideways motion {' or '.join(LATERAL)} (free under axial load)",
    )
    tensile.add_argument(
        "--peak-drop",
        type=float,
        metavar="X",
        help="end a test when the force has fallen by this fraction (0.05); 1: the whole curve",
    )
    tensile.add_argument(
        "--final-strain",
        type=float,
        metavar="X",
        help="end a test at this elongation over the length between the grips (0.1)",
    )
    tensile.add_argument(
        "--increment", type=float, metavar="X", help="largest strain increment (preset)"
    )
    tensile.add_argument(
        "--damage",
        metavar="D",
        help=f"how f grows: {', '.join(DAMAGE_UPDATES)} (one f per point; implicit: as published)",
    )
    tensile.add_argument(
        "--mapping",
        metavar="M",
        help=f"lattice to mesh: {', '.join(MAPPINGS)} (auto: exposures where the scene allows; a "
        "cell's skin goes first)",
    )
    tensile.add_argument(
        "--damage-length", metavar="LENGTH", help="over which the growth of f is averaged (0mm)"
    )


def scene_from_options(options: argparse.Namespace) -> Scene:
    """Build the scene that the options describe; ValueError or OSError with one sentence."""
    from pipeline.scene.resolve import resolve_scene

    if getattr(options, "scene", None) is not None:
        return _stored_scene(options)

    def length(name: str) -> float | None:
        text = getattr(options, name)
        return None if text is None else parse_length(text, name.replace("_", " "))

    def given(**names: str) -> dict[str, object]:
        values = {field: getattr(options, name) for field, name in names.items()}
        return {field: value for field, value in values.items() if value is not None}

    corrosion = given(
        scheme="scheme",
        saturation="saturation",
        dissolution="dissolution",
        kinetics="kinetics",
        calibration="calibration",
        rate_change="rate_change",
        tolerance="tolerance",
    )
    if options.classes is not None:
        corrosion["classes"] = read_classes(options.classes)
    if options.coating is not None:
        corrosion["coating"] = read_coating(options.coating)
    if options.keep:
        corrosion["keep"] = tuple(options.keep)
    if options.step is not None:
        corrosion["step"] = parse_time(options.step, "step").seconds
    tensile = given(
        element="element",
        lateral="lateral",
        final_strain="final_strain",
        increment="increment",
        peak_drop="peak_drop",
        damage="damage",
        mapping="mapping",
        load="load",
    )
    if options.bending_azimuth is not None:
        load = options.load or "axial"
        if load != "bending":  # the scene, which refuses this too, does not know the unit typed
            raise ValueError(
                f"bending azimuth is {options.bending_azimuth}; it must be left out where the "
                f"load is {load}"
            )
        tensile["bending_azimuth"] = parse_angle(options.bending_azimuth, "bending azimuth")
    for name in ("bottom_grip", "top_grip", "damage_length"):
        if getattr(options, name) is not None:
            tensile[name] = length(name)
    scene = resolve_scene(
        options.alloy,
        options.immersion,
        options.resolution,
        parameter_set=options.parameters,
        geometry=_geometry(options),
        spacing=None if options.spacing == "auto" else length("spacing"),
        horizon=length("horizon"),
        mesh_size=length("mesh_size"),
        mesh_size_fine=length("mesh_size_fine"),
        mesh_size_faces=length("mesh_size_faces"),
        domain=_domain(options),
        corrosion=corrosion,
        hold=options.hold,
        tensile=tensile,
        measured_volume_loss=_measured(options),
        ions=_ions(options),
    )
    if options.hardening:
        from pipeline.scene.laws.hardening import with_hardening

        scene = with_hardening(scene, options.hardening)
    if options.kinetics is not None:
        from pipeline.scene.resolve import rate_law

        for alloy in scene.alloys:
            rate_law(scene, alloy.name)  # refuses numbers out of range, and another C_sat
    if scene.ions is not None and scene.ions.feedback is not None:
        from peri.corrosion.liquid_factors import LiquidFactors
        from pipeline.scene.resolve import rate_law

        asked = scene.ions.feedback
        LiquidFactors(  # refuses a layer that the law contains already
            rate_law(scene, scene.alloys[0].name),
            layer_thickness=asked.layer_thickness or math.inf,
            layer_twice=asked.layer_twice,
        )
    return scene


def _stored_scene(options: argparse.Namespace) -> Scene:
    """The resolved scene that the options name, beside which no option of a scene may be given."""
    from pipeline.scene.command.scene_file import read_stored

    parser = argparse.ArgumentParser(add_help=False)
    add_scene_options(parser)
    for action in parser._actions:
        if getattr(options, action.dest, action.default) != action.default:
            raise ValueError(
                f"{action.option_strings[-1]} is given beside '{options.scene}', which has every "
                "number of a scene; it must be left out, or the scene be a TOML file"
            )
    scene = read_stored(options.scene)
    solid = scene.geometry
    if isinstance(solid, SolidFile | ImageFile) and content_of(Path(solid.path)) != solid.sha256:
        raise ValueError(
            f"solid is '{solid.path}'; it was changed after '{options.scene}' was written"
        )
    return scene


def _geometry(options: argparse.Namespace) -> Geometry:
    from pipeline.scene.resolve import solid_file

    screw = {
        name: parse_length(getattr(options, name), name.replace("_", " "))
        for name in _SCREW_LENGTHS
        if getattr(options, name) is not None
    }
    if options.thread is not None:
        screw["thread"] = options.thread
    image = image_from_options(options)
    if image is not None and (screw or options.solid is not None):
        other = "solid" if options.solid is not None else next(iter(screw)).replace("_", "-")
        raise ValueError(f"--{other} describes another solid and must not join --image")
    if options.solid is None:
        if options.unit is not None:
            raise ValueError("--unit goes with --solid, which must be given too")
        return image or ScrewGeometry(ScrewParameters(**screw))
    if screw:
        name = next(iter(screw)).replace("_", "-")
        raise ValueError(f"--{name} describes the parametric screw and must not join --solid")
    return solid_file(options.solid, options.unit or "mm")


def _domain(options: argparse.Namespace) -> DomainSettings | None:
    changes = {
        name: parse_length(getattr(options, name), name.replace("_", " "))
        for name in ("radial_margin", "axial_margin")
        if getattr(options, name) is not None
    }
    if options.domain is not None:
        changes["shape"] = options.domain
    if options.boundary is not None:
        changes["boundary"] = options.boundary
    return dataclasses.replace(DomainSettings(), **changes) if changes else None


def _ions(options: argparse.Namespace) -> IonSettings | None:
    names = ("medium", "minerals", "activity", "flux_form", "closure", "balance")
    names = (*names, "bath_volume", "exchange_every", "open_to", "feedback", "electrodes")
    given = {n: getattr(options, n) for n in names if getattr(options, n) is not None}
    if options.model == "bi-material":
        if given:
            name = next(iter(given)).replace("_", "-")
            raise ValueError(f"--{name} goes with --model nnpp, which must be given too")
        return None
    if options.bath_volume is not None:
        given["bath_volume"] = parse_volume(options.bath_volume, "bath volume")
    if options.exchange_every is not None:
        given["exchange_every"] = parse_time(options.exchange_every, "exchange every").seconds
    if options.feedback is not None:
        given["feedback"] = read_feedback(options.feedback)
    if options.electrodes is not None:
        if options.kinetics is not None:
            raise ValueError("--electrodes takes the place of --kinetics, which must be left out")
        given["electrodes"] = read_electrodes(options.electrodes)
    if options.open_to is not None:
        given["open_to"] = tuple(options.open_to)
    return resolve_ions(**given)


def _measured(options: argparse.Namespace) -> dict[str, str]:
    import perilife_data

    files: dict[str, str] = {}
    for text in options.volume_loss:
        alloy, equals, path = text.partition("=")
        if not equals or not alloy or not path:
            raise ValueError(f"volume loss '{text}' is not understood; write ALLOY=FILE.csv")
        perilife_data.read_volume_loss_csv(path)
        files[alloy] = str(Path(path).resolve())
    return files
