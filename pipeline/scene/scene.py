"""The resolved scene: every number a run depends on, checked, stored and hashed.

A scene is built once (pipeline.scene.resolve), written as `scene.json` and never changed; each
stage reads its numbers from it (pipeline.record.stage_hashes says which).
"""

import dataclasses
import hashlib
import json
import math
import types
import typing
from dataclasses import dataclass, field

from peri.corrosion.choices import BOUNDARIES
from peri.corrosion.choices import SATURATION_MODELS as SATURATIONS
from peri.corrosion.laws import INTERFACE_LAWS
from peri.engine.choices import CALIBRATIONS, INFLUENCES
from peri.engine.march.stepping import SCHEMES as TIME_SCHEMES
from peri.engine.omission import DEFAULT_TOLERANCE
from peri.omissions.names import OMITTABLE
from perilife_data import did_you_mean
from perilife_data.limits import LARGEST_YIELD_STRAIN
from pipeline.scene.checks import SceneError, at_most, check, check_times, one_of, positive
from pipeline.scene.image import ImageFile
from pipeline.scene.laws.coating import CoatingScene
from pipeline.scene.laws.ions import IonSettings
from pipeline.scene.laws.rate_law import read_kinetics
from pipeline.scene.mechanics import HoldScene, MeshSettings, TensileScene
from pipeline.scene.screw import ScrewParameters
from pipeline.scene.units import ImmersionTime, format_length, parse_time

SCHEMA_VERSION = 2

DOMAIN_SHAPES = ("cylinder", "ball")
DISSOLUTION_LAWS = tuple(INTERFACE_LAWS)


@dataclass(frozen=True)
class ScrewGeometry:
    """The parametric screw of pipeline.scene.screw; its axis is z, the slot is at z = length."""

    parameters: ScrewParameters = field(default_factory=ScrewParameters)
    kind: str = "screw"


@dataclass(frozen=True)
class SolidFile:
    """A closed solid from a STEP, BREP or STL file; sha256 is that of the file's content."""

    path: str
    unit: str
    sha256: str
    kind: str = "file"


Geometry = ScrewGeometry | SolidFile | ImageFile


@dataclass(frozen=True)
class LatticeSettings:
    """Spacing and horizon of the peridynamic lattice (m); samples per axis and cell for the
    volume fraction."""

    spacing: float
    horizon: float
    samples: int = 4

    def __post_init__(self) -> None:
        positive("lattice spacing", self.spacing)
        ratio = self.horizon / self.spacing
        check(
            0.999 <= ratio <= 8.001,
            "horizon",
            format_length(self.horizon),
            f"1 to 8 lattice spacings of {format_length(self.spacing)}",
        )
        check(1 <= self.samples <= 16, "samples per axis", self.samples, "1 to 16")


@dataclass(frozen=True)
class DomainSettings:
    """Liquid around the solid: a cylinder along z or a ball, centred on the solid.

    radial_margin, axial_margin: distance of the domain's outer surface from the solid (m); the
    ball uses the radial one.  With boundary "refreshed" the outermost layer, one horizon wide,
    holds the refreshed medium.  The defaults give the M2 x 4 mm screw the cylinder of 3 mm x
    4.8 mm in which Table 5.1 was calibrated.
    """

    shape: str = "cylinder"
    radial_margin: float = 0.5e-3
    axial_margin: float = 0.4e-3
    boundary: str = "refreshed"

    def __post_init__(self) -> None:
        one_of("domain shape", self.shape, DOMAIN_SHAPES)
        one_of("boundary", self.boundary, BOUNDARIES)
        positive("radial margin", self.radial_margin)
        positive("axial margin", self.axial_margin)


@dataclass(frozen=True)
class CorrosionSettings:
    """How the bi-material model is solved: law of a bond, time stepping, saturation, constants.

    kinetics: how the rate changes, NAME or NAME:number=value,... (pipeline.scene.laws.rate_law).
    dissolution: what a bond between metal and liquid carries (peri.corrosion.scene).
    step: fixed time step (s); None lets rate_change control it
    (peri.engine.march.marching.TimeStepping).
    classes: rate classes per cell near the surface (peri.engine.surface.rate_classes); 0: each node
    has one phase and one rate.
    tolerance: error of V_L, relative, up to which the march leaves out what the scene does not
    need (peri.omissions.planning); keep: what to compute all the same.
    coating: what holds the rate back for a time, whatever its law.
    """

    scheme: str = "sdirk2"
    step: float | None = None
    rate_change: float = 0.05
    saturation: str = "complementarity"
    kinetics: str = "volume_loss"
    dissolution: str = "proportional"
    calibration: str = "discrete"
    influence: str = "constant"
    kernel_exponent: float = 0.0
    classes: int = 0
    tolerance: float = DEFAULT_TOLERANCE
    keep: tuple[str, ...] = ()
    coating: CoatingScene | None = None

    def __post_init__(self) -> None:
        if self.step is not None:
            positive("corrosion step", self.step)
        check(0 <= self.tolerance < 1, "tolerance", self.tolerance, "in [0, 1)")
        for name in self.keep:
            one_of("keep", name, OMITTABLE)
        check(0 < self.rate_change <= 1, "rate change", self.rate_change, "in (0, 1]")
        one_of("time scheme", self.scheme, TIME_SCHEMES)
        one_of("saturation", self.saturation, SATURATIONS)
        one_of("dissolution", self.dissolution, DISSOLUTION_LAWS)
        try:
            read_kinetics(self.kinetics)
        except ValueError as error:
            raise SceneError(str(error)) from None
        if self.saturation == "as_published":
            implicit = "backward_euler or forward_euler where saturation is as_published"
            check(self.scheme != "sdirk2", "time scheme", self.scheme, implicit)
        if self.dissolution == "faradaic":
            bounded = "complementarity or none where dissolution is faradaic"
            check(self.saturation != "as_published", "saturation", self.saturation, bounded)
            implicit = "sdirk2 or backward_euler where dissolution is faradaic"
            check(self.scheme != "forward_euler", "time scheme", self.scheme, implicit)
        if self.saturation == "as_published":
            given = self.step is not None or self.scheme == "forward_euler"
            allowed = "a fixed one where saturation is as_published, whose switch lasts for a step"
            check(given, "corrosion step", "controlled", allowed)
        one_of("calibration", self.calibration, CALIBRATIONS)
        one_of("influence function", self.influence, INFLUENCES)
        check(0 <= self.kernel_exponent < 1, "kernel exponent", self.kernel_exponent, "in [0, 1)")
        check(0 <= self.classes <= 8, "rate classes", self.classes, "0 (none) to 8")
        if self.classes:
            on = "where there are rate classes"
            free = ("none",) if self.dissolution == "faradaic" else ()
            one_of(f"saturation {on}", self.saturation, ("complementarity", *free))
            one_of(f"time scheme {on}", self.scheme, ("sdirk2", "backward_euler"))
            check(
                self.kernel_exponent < 0.5, "kernel exponent", self.kernel_exponent, f"< 1/2 {on}"
            )


@dataclass(frozen=True)
class CorrosionParameters:
    """Constants of the bi-material model for one alloy, SI (mol/m^3, m^2/s, m).

    interface_diffusivity belongs to the lattice and stencil constants it was calibrated on
    (calibration_spacing, calibration_horizon, calibration); pipeline.stages.corrosion turns it
    into a dissolution flux there, once.
    volume_loss_scale is l of Eq. 5.13, dimensionless.
    Of an alloy that nobody has fitted only the solid concentration is known, the others are None:
    it can be tested intact, not corroded (Scene refuses that).
    """

    solid_concentration: float
    saturation_concentration: float | None
    liquid_diffusivity: float | None
    interface_diffusivity: float | None
    volume_loss_scale: float | None
    calibration_spacing: float = 100e-6
    calibration_horizon: float = 200e-6
    calibration: str = "closed"

    def __post_init__(self) -> None:
        given = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        unknown = [name.replace("_", " ") for name, value in given.items() if value is None]
        check(len(unknown) in (0, 4), " and ".join(unknown), "not given", "given, or all four not")
        for name, value in given.items():
            if name != "calibration" and value is not None:
                positive(name.replace("_", " "), value)
        one_of("calibration", self.calibration, CALIBRATIONS)
        check(
            unknown or self.saturation_concentration < self.solid_concentration,
            "saturation concentration",
            f"{self.saturation_concentration} mol/m^3",
            f"below the solid concentration, {self.solid_concentration} mol/m^3",
        )

    @property
    def known(self) -> bool:
        """Whether the alloy can be corroded."""
        return self.interface_diffusivity is not None

    def at_rest(self) -> "CorrosionParameters":
        """These, or, where they are not known, any: a march of no time uses none of them."""
        if self.known:
            return self
        return CorrosionParameters(self.solid_concentration, 1e-5 * self.solid_concentration,
                                   1e-9, 1e-15, 1.0)  # fmt: skip


@dataclass(frozen=True)
class MaterialParameters:
    """Elasticity (Pa), Voce hardening s0 + Q (1 - exp(-b eps)) (Pa, Pa, 1) and q1."""

    young_modulus: float
    poisson_ratio: float
    initial_yield_stress: float
    hardening_capacity: float
    hardening_rate: float
    q1: float = 1.5

    def __post_init__(self) -> None:
        positive("Young modulus", self.young_modulus)
        check(
            -1 < self.poisson_ratio < 0.5,
            "Poisson ratio",
            self.poisson_ratio,
            "above -1 and below 0.5",
        )
        positive("initial yield stress", self.initial_yield_stress)
        capacity = self.hardening_capacity
        finite = math.isfinite(capacity) and capacity >= 0
        check(finite, "hardening capacity", capacity, "a finite number, at least 0")
        positive("hardening rate", self.hardening_rate)
        check(1 < self.q1 < 10, "q1", self.q1, "above 1 and below 10")
        check(
            at_most(self.initial_yield_stress, LARGEST_YIELD_STRAIN * self.young_modulus),
            "initial yield stress",
            f"{self.initial_yield_stress:g} Pa",
            f"at most {LARGEST_YIELD_STRAIN:g} of the Young modulus, {self.young_modulus:g} Pa",
        )


@dataclass(frozen=True)
class AlloyScene:
    """One alloy of the scene: its name, where it came from, and its constants.

    hardening: name or file of another record than the alloy's own, empty for its own.
    """

    name: str
    corrosion: CorrosionParameters
    material: MaterialParameters
    source: str = ""
    hardening: str = ""

    def __post_init__(self) -> None:
        check(
            bool(self.name) and "/" not in self.name and not self.name.startswith("."),
            "alloy name",
            f"'{self.name}'",
            "a name without '/' that does not start with a dot",
        )


@dataclass(frozen=True)
class Scene:
    """Every number of a run, SI; `resolution` and `parameter_set` only say where from.

    holds: the ways of holding in which each corroded solid is tested, all with one load.
    """

    resolution: str
    parameter_set: str
    geometry: Geometry
    immersion: tuple[ImmersionTime, ...]
    alloys: tuple[AlloyScene, ...]
    lattice: LatticeSettings
    domain: DomainSettings
    corrosion: CorrosionSettings
    holds: tuple[HoldScene, ...]
    measured_volume_loss: dict[str, str] = field(default_factory=dict)
    ions: IonSettings | None = None
    schema_version: int = SCHEMA_VERSION

    def __post_init__(self) -> None:
        check(bool(self.alloys), "list of alloys", "empty", "at least one alloy")
        names = [alloy.name for alloy in self.alloys]
        check(
            len(set(names)) == len(names), "list of alloys", " ".join(names), "without repetition"
        )
        check_times(self.immersion, self.corrosion.step)
        last = self.immersion[-1]
        unknown = [alloy.name for alloy in self.alloys if not alloy.corrosion.known]
        if unknown and last.seconds > 0:
            raise SceneError(
                f"alloy {unknown[0]} has no corrosion constants, so it can be pulled (--immersion "
                f"0w), not corroded ({last.label}); they stand in [corrosion] of an alloy's own "
                "file (the end of what `perilife alloy new` writes has some to begin with) or in a "
                "set that --parameters names (`perilife calibrate` fits one to volume losses)"
            )
        check(bool(self.holds), "list of ways of holding", "empty", "at least one")
        ways = [hold.name for hold in self.holds]
        check(len(set(ways)) == len(ways), "list of ways of holding", ways, "without repetition")
        loads = sorted({hold.tensile.load for hold in self.holds})
        check(len(loads) == 1, "load", " and ".join(loads), "one for all ways of holding")
        if not self.corrosion.classes or self.corrosion.dissolution != "proportional":
            for mapping in {hold.tensile.mapping for hold in self.holds}:
                only = "nodes or auto without rate classes and the proportional law of dissolution"
                check(mapping != "exposures", "mapping", mapping, only)
        least = self.lattice.horizon + self.lattice.spacing
        for name in ("radial_margin", "axial_margin"):
            margin = getattr(self.domain, name)
            check(
                at_most(least, margin) or self.domain.boundary != "refreshed",
                name.replace("_", " "),
                format_length(margin),
                f"at least horizon plus lattice spacing, {format_length(least)}",
            )

        if self.ions is not None:
            bare = "left out where --model is nnpp"
            check(self.corrosion.coating is None, "coating", self.corrosion.coating, bare)
            for name, value, right, why in (
                ("dissolution", self.corrosion.dissolution, "proportional", ""),
                ("rate classes", self.corrosion.classes, 0, ""),
                *self._closed(),
            ):
                check(value == right, name, f"'{value}'", f"{right} where the model is nnpp{why}")

    def _closed(self) -> list[tuple[str, str, str, str]]:
        """What of the ions wants liquid that is refreshed: name, given, right and why."""
        ions, boundary = self.ions, self.domain.boundary
        applied = ions.electrodes is not None and ions.electrodes.balance == "applied"
        wants = {
            " and a current is applied, which leaves through it": applied,
            " and the medium is a bath, which is beyond it": ions.bath_volume is not None,
            f" with closure {ions.closure}": ions.closure in ("poisson", "as_published"),
        }
        found = [("boundary", boundary, "refreshed", why) for why, true in wants.items() if true]
        if boundary == "no_flux":  # a C_sat would stop the metal long before its ions are full
            why = " and the vessel is closed, where the minerals take what dissolves"
            found.append(("saturation", self.corrosion.saturation, "none", why))
        return found

    @property
    def mesh(self) -> MeshSettings:
        """The mesh of the first way of holding, which pictures show."""
        return self.holds[0].mesh

    @property
    def tensile(self) -> TensileScene:
        """The test of the first way of holding; the load is that of all."""
        return self.holds[0].tensile

    def meshes(self) -> dict[str, MeshSettings]:
        """The distinct meshes by their folder below that of the geometry, "" for the first."""
        found: dict[str, MeshSettings] = {}
        for hold in self.holds:
            if hold.mesh not in found.values():
                found[hold.name if found else ""] = hold.mesh
        return found

    def mesh_folder(self, hold: HoldScene) -> str:
        """The folder below that of the geometry with the mesh of a way of holding."""
        return next(folder for folder, mesh in self.meshes().items() if mesh == hold.mesh)

    def hold(self, name: str) -> HoldScene:
        """The way of holding called `name`; SceneError names those of the scene."""
        for hold in self.holds:
            if hold.name == name:
                return hold
        known = ", ".join(hold.name for hold in self.holds)
        raise SceneError(f"hold '{name}' is not part of this run; it has {known}")

    def alloy(self, name: str) -> AlloyScene:
        """The alloy called `name`; SceneError names those of the scene."""
        for alloy in self.alloys:
            if alloy.name == name:
                return alloy
        raise _not_part("alloy", name, [alloy.name for alloy in self.alloys])

    def time(self, text: str) -> ImmersionTime:
        """The time of the run, zero among them, that `text` gives in any unit; else SceneError."""
        wanted, times = parse_time(text, "immersion time").seconds, self.with_intact()
        for time in times:
            if math.isclose(time.seconds, wanted, rel_tol=1e-9):
                return time
        raise _not_part("immersion time", text, [time.label for time in times])

    def with_intact(self) -> tuple[ImmersionTime, ...]:
        """The immersion times with time zero in front, which the strength left needs."""
        if self.immersion[0].seconds == 0:
            return self.immersion
        return (ImmersionTime("0w", 0.0), *self.immersion)

    def at(self, *times: ImmersionTime) -> "Scene":
        """The scene at other times; a fixed time step is at most the last of them."""
        step, last = self.corrosion.step, times[-1].seconds
        if step is not None and 0 < last < step:
            step = last
        corrosion = dataclasses.replace(self.corrosion, step=step)
        return dataclasses.replace(self, immersion=times, corrosion=corrosion)

    def to_json(self) -> dict:
        """Plain mapping that `scene_from_json` turns back into an equal scene."""
        content = json.loads(json.dumps(dataclasses.asdict(self), allow_nan=False))
        if self.ions is None:
            del content["ions"]
        return content

    def hash(self) -> str:
        """Hash of everything in the scene."""
        return content_hash(self.to_json())


def _not_part(what: str, name: str, known: list[str]) -> SceneError:
    near = did_you_mean(name, known)
    return SceneError(f"{what} '{name}'{near} is not part of this run; it has {', '.join(known)}")


def content_hash(*parts: object) -> str:
    """SHA-256 of the canonical JSON of `parts` (sorted keys, shortest round-trip floats)."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def scene_from_json(content: dict) -> Scene:
    """Rebuild and check a scene; SceneError when a field is missing, unknown or wrong."""
    if not isinstance(content, dict):
        raise SceneError("scene file does not hold a JSON object, which it must")
    version = content.get("schema_version")
    if version is None:
        raise SceneError(
            "scene file is no scene.json of a run, which says its schema_version; a scene by hand "
            "must be a TOML file (perilife init)"
        )
    check(version == SCHEMA_VERSION, "schema version of the scene", version, f"{SCHEMA_VERSION}")
    return _build(Scene, content, "scene")


def _build(kind: typing.Any, value: typing.Any, where: str) -> typing.Any:
    """Turn parsed JSON into `kind`, following the type hints of the dataclasses."""
    origin = typing.get_origin(kind)
    if origin in (types.UnionType, typing.Union):
        options = [option for option in typing.get_args(kind) if option is not type(None)]
        if len(options) == 1:
            return None if value is None else _build(options[0], value, where)
        tags = {option.kind: option for option in options}
        tag = value.get("kind") if isinstance(value, dict) else None
        check(tag in tags, f"kind of {where}", tag, f"one of {', '.join(tags)}")
        return _build(tags[tag], value, where)
    if origin is tuple:
        check(isinstance(value, list), where, value, "a list")
        inner = typing.get_args(kind)[0]
        return tuple(_build(inner, item, f"{where}[{n}]") for n, item in enumerate(value))
    if dataclasses.is_dataclass(kind):
        check(isinstance(value, dict), where, value, "an object")
        hints = typing.get_type_hints(kind)
        for name in sorted(set(value) - set(hints)):
            near = did_you_mean(name, hints)
            check(False, f"field '{name}' of {where}", f"unknown{near}", "left out")
        missing = sorted(
            f.name
            for f in dataclasses.fields(kind)
            if f.name not in value
            and f.default is dataclasses.MISSING
            and f.default_factory is dataclasses.MISSING
        )
        check(not missing, f"field '{', '.join(missing)}' of {where}", "missing", "given")
        return kind(**{k: _build(hints[k], v, f"{where}.{k}") for k, v in value.items()})
    if kind is float:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        check(number, where, repr(value), "a number")
        return float(value)
    if kind in (int, str, bool):
        exact = type(value) is kind
        check(exact, where, repr(value), f"of type {kind.__name__}")
    return value
