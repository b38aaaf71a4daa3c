"""Files of pits and of grains in a section of a sheet: their keys, and the scenes they make."""

from __future__ import annotations

import functools
from collections.abc import Callable

from peri.corrosion.metal.salt_film import SaltFilm
from peri.corrosion.passivity import Repassivation
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.marching import TimeStepping
from peri.engine.omission import Omission
from peri.omissions.activation import TRANSPORT, activation
from pipeline.scenes.grains import grain_scene
from pipeline.scenes.keys import COUNT, TEXT, Given, Key, positive
from pipeline.scenes.lattices import LATTICE_KEYS, check_count, horizon_of
from pipeline.scenes.outcome import March, Prepared
from pipeline.scenes.pits import march_pencil, pencil_scene, unfilled_step
from pipeline.scenes.pits_2d import lacy_scene, march_section, masked_scene

SHAPES = ("pencil", "mask", "film")
_COMMON: dict[str, Key] = {
    **LATTICE_KEYS,
    "liquid.saturation_concentration": positive("concentration", "C_sat", "4600 mol/m^3"),
    "liquid.diffusivity": positive("diffusivity", "of the metal's ions", "8.6e-10 m^2/s"),
    "geometry.width": positive("length", "of the section, along the sheet", "600um"),
    "geometry.depth": positive("length", "of the metal", "250um"),
    "damage.seed": Key(
        COUNT, "of the broken bonds, and of the grains (1)", 1, at_least=0, at_most=2**64 - 1
    ),
    "reduce.keep": Key(
        TEXT,
        "what is computed whatever its bound",
        ["transport"],
        allowed=(TRANSPORT,),
        several=True,
    ),
    "time.step": positive(
        "time", "left out: that in which the flux fills a node that it has emptied", "1s"
    ),
}
PIT_KEYS: dict[str, Key] = {
    **_COMMON,
    "metal.solid_concentration": positive("concentration", "C_solid", "142900 mol/m^3"),
    "metal.charge_number": positive("dimensionless", "z of its ions", 2.19),
    "metal.current_density": positive("current density", "of bare metal", "5100 A/m^2"),
    "salt.conductivity": positive(
        "conductivity", "of the salt film; left out: no film is stated", "0.01 S/m"
    ),
    "salt.tafel_slope": positive("electric potential", "of the metal below it, per decade", "0.1V"),
    "salt.molar_volume": positive("molar volume", "of the salt per mol of metal", "1e-4 m^3/mol"),
    "geometry.shape": Key(
        TEXT,
        "pencil: a wire in resin; mask: a sheet below an opening; film: a passive sheet with an "
        "active nucleus",
        "mask",
        allowed=SHAPES,
    ),
    "geometry.opening": positive("length", "of the mask", "40um"),
    "geometry.nucleus": positive("length", "radius of the active half disc of a film", "20um"),
    "film.critical_concentration": positive(
        "dimensionless", "C_crit over C_sat, below which metal is passive", 0.7
    ),
    "film.passive_share": Key(
        "dimensionless", "passive current over the bare one", 1e-3, at_least=0.0
    ),
    "film.ramp_width": positive("dimensionless", "from passive to bare, over C_sat (0.02)", 0.02),
    "film.rupture": positive(
        "dimensionless",
        "share of a node's metal with whose loss its film breaks for good; left out: it never does",
        0.15,
    ),
    "film.rupture_width": positive(
        "dimensionless", "further share over which it breaks (0.02)", 0.02
    ),
}
"""Keys of a pit's file."""
GRAIN_KEYS: dict[str, Key] = {
    **_COMMON,
    "metal.solid_concentration": positive("concentration", "C_solid", "1e5 mol/m^3"),
    "metal.charge_number": positive("dimensionless", "z of its ions", 3),
    "metal.current_density": positive("current density", "of the grains' boundaries", "100 A/m^2"),
    "grains.along": positive("length", "size along the sheet", "30um"),
    "grains.across": positive("length", "size across the sheet", "15um"),
    "grains.current_share": positive(
        "dimensionless", "current of the grains over that of their boundaries", 0.02
    ),
    "grains.boundary_width": positive(
        "length", "at least two spacings; left out: those, or 2 um", "2um"
    ),
}
"""Keys of a file of grains."""


def _ratio(given: Given) -> float:
    """Horizon over spacing; a whole number stays one, so that nodes fall as in the studies."""
    ratio = horizon_of(given) / given.number("lattice.spacing")
    return round(ratio) if abs(ratio - round(ratio)) < 1e-9 else ratio


def _ions(given: Given) -> dict[str, float]:
    """Concentrations and diffusivity as a scene takes them; ValueError for C_sat above C_solid."""
    solid = given.number("metal.solid_concentration")
    most = given.number("liquid.saturation_concentration")
    if not most < solid:
        raise ValueError(
            f"{given.file}: liquid.saturation_concentration is {most:g} mol/m^3; it must be below "
            f"metal.solid_concentration of {solid:g} mol/m^3"
        )
    return {
        "solid_concentration": solid,
        "saturation_concentration": most,
        "liquid_diffusivity": given.number("liquid.diffusivity"),
    }


def _stepping(given: Given, scene: CorrosionScene) -> TimeStepping:
    unfilled = unfilled_step(scene)
    step = given.otherwise("time.step", unfilled, "s", "the flux fills an emptied node in it")
    assert isinstance(step, float)
    return TimeStepping(step=step)


def _size(given: Given) -> tuple[float, float]:
    """Width and depth of a section, m."""
    width, depth = given.number("geometry.width"), given.number("geometry.depth")
    check_count(given, width * depth / given.number("lattice.spacing") ** 2)
    return width, depth


def _seed(given: Given) -> int:
    return int(given.otherwise("damage.seed", 1, "", "any"))  # type: ignore[call-overload]


def pit(given: Given) -> Prepared:
    """A pit of a file, ready to run."""
    spacing, ratio, steel = given.number("lattice.spacing"), _ratio(given), _ions(given)
    charge = given.number("metal.charge_number")
    current = given.number("metal.current_density")
    shape = given.text("geometry.shape")
    march: March
    if shape == "pencil":
        depth = given.number("geometry.depth")
        check_count(given, depth / spacing)
        scene = pencil_scene(spacing, ratio, current, depth, charge, steel)
        march = functools.partial(
            march_pencil, scene, _stepping(given, scene), charge, kept=_kept(given),
            salt=_salt(given, charge),
        )  # fmt: skip
    else:
        size = _size(given)
        if shape == "mask":
            opening = given.number("geometry.opening")
            scene = masked_scene(spacing, current, opening, ratio, size, charge, steel)
        else:
            scene = _film(given, spacing, ratio, current, size, charge, steel)
        march = functools.partial(
            march_section, scene, _stepping(given, scene), _seed(given), kept=_kept(given),
            salt=_salt(given, charge),
        )  # fmt: skip
    kept = _kept(given)
    given.left_over()
    return _prepared(given, march, scene, kept)


def _salt(given: Given, charge: float) -> SaltFilm | None:
    """The ohmic film of salt that a file describes."""
    if "salt.conductivity" not in given:
        return None
    slope, volume = given.number("salt.tafel_slope"), given.number("salt.molar_volume")
    return SaltFilm(given.number("salt.conductivity"), slope, charge, volume)


def _kept(given: Given) -> list[str]:
    """What is not left out."""
    kept = given["reduce.keep"] if "reduce.keep" in given else []
    assert isinstance(kept, list)
    return kept


def _film(given: Given, spacing, ratio, current, size, charge, steel) -> CorrosionScene:
    critical = given.number("film.critical_concentration")
    most = steel["saturation_concentration"]
    ramp = given.otherwise("film.ramp_width", 0.02, "1", "2 % of saturation")
    assert isinstance(ramp, float)
    if not critical + ramp <= 1 + 1e-12:
        raise ValueError(
            f"{given.file}: film.critical_concentration is {critical:g} of C_sat; with the ramp of "
            f"{ramp:g} it must be at most {1 - ramp:g}, or no pit could begin"
        )
    passive = given.number("film.passive_share")
    if not passive < 1:
        raise ValueError(f"{given.file}: film.passive_share is {passive:g}; it must be below 1")
    return lacy_scene(
        spacing, current, critical, given.number("geometry.nucleus"), passive, ratio, size,
        _rupture(given), ramp=ramp * most, charge=charge, steel=steel,
    )  # fmt: skip


def _rupture(given: Given) -> tuple[float, float] | None:
    """When the film breaks over undermined metal, and over what share; None: never."""
    if "film.rupture" not in given:
        return None
    share = given.number("film.rupture")
    width = given.otherwise("film.rupture_width", 0.02, "1", "0.02 of a node's metal")
    assert isinstance(width, float)
    if not share + width <= 1 + 1e-12:
        raise ValueError(
            f"{given.file}: film.rupture is {share:g} of a node's metal; with the width of "
            f"{width:g} it must be at most {1 - width:g}"
        )
    return share, width


def grains(given: Given) -> Prepared:
    """Grains and their boundaries in a file, ready to run."""
    spacing, ratio, alloy = given.number("lattice.spacing"), _ratio(given), _ions(given)
    width = given.otherwise(
        "grains.boundary_width", max(2e-6, 2 * spacing), "m", "two spacings, 2 um at least"
    )
    size = _size(given)
    try:
        scene = grain_scene(
            spacing,
            (given.number("grains.along"), given.number("grains.across")),
            given.number("grains.current_share"),
            _seed(given),
            width,  # type: ignore[arg-type]
            given.number("metal.current_density"),
            given.number("metal.charge_number"),
            ratio,
            size,
            alloy,
        )
    except ValueError as error:
        raise ValueError(f"{given.file}: [grains] {error}") from None
    kept = _kept(given)
    march = functools.partial(
        march_section, scene, _stepping(given, scene), _seed(given), kept=kept
    )
    given.left_over()
    return _prepared(given, march, scene, kept)


def _reductions(scene: CorrosionScene, kept: list[str]) -> Callable[[float], list[Omission]]:
    """What a pit's march has no unknowns for, and whether it needs the liquid."""

    def found(end: float) -> list[Omission]:
        exact = [
            ("metal", "what a node loses follows from the liquid beside it, so it is no unknown"),
            ("saturated liquid", "a node under a salt layer has C_sat, which is no unknown"),
        ]
        if any(isinstance(scene.law_of(solid), Repassivation) for solid in scene.solids):
            exact.append(("passive metal", "its current follows from the liquid that it sees"))
        omissions = [Omission(name, why, 0.0, True, "what is lost") for name, why in exact]
        return [*omissions, activation(scene, end, refused=kept)]

    return found


def _prepared(given: Given, march: March, scene: CorrosionScene, kept: list[str]) -> Prepared:
    reductions, nodes = _reductions(scene, kept), scene.metal.size
    return Prepared(given.values, march, {}, reductions, _nodes(scene), nodes=nodes)


def _nodes(scene: CorrosionScene) -> str:
    """How much is marched, in words."""
    liquid = int((scene.domain & ~scene.metal).sum())
    return f"{int(scene.metal.sum()):,} metal nodes, {liquid:,} of liquid at the start"
