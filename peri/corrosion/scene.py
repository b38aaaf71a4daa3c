"""What is corroded: lattice, phases, transport, kinetics; validated, immutable."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from peri.corrosion.choices import (
    BOUNDARIES,
    CLASS_LAWS,
    DETACHED,
    FLUX_CALIBRATIONS,
    SATURATION_MODELS,
)
from peri.corrosion.coating import Coating
from peri.corrosion.kinetics import QUANTITIES, ConstantRate, Kinetics
from peri.corrosion.laws import InterfaceLaw, interface_law
from peri.corrosion.metal.solids import Solid
from peri.engine.cells import hand_over
from peri.engine.influence import Stencil, closed_strength, diffusion_stencil, front_stencil
from peri.engine.lattice import Lattice

if TYPE_CHECKING:
    from peri.engine.surface.flat_front import FlatFront
    from peri.engine.surface.rate_classes import CellExposure
    from peri.engine.surface.share_weights import ShareBonds


@dataclass(frozen=True)
class CorrosionScene:
    """A metal in a liquid on a lattice.

    Parameters
    ----------
    lattice : Lattice
    horizon : float or sequence
        m.
    metal : bool array of the lattice's shape
        Nodes that are metal at the start.
    domain : bool array, optional
        Nodes that exist (default: all); the rest of the box is empty.
    liquid : float array of the lattice's shape, optional
        Concentration that liquid nodes begin with, mol/m^3, from 0 to C_sat (default: 0).
    metal_fraction : float array, optional
        Share of each cell that is metal, 0..1.  Cells then count with their true volume (see
        `capacity`); without it every cell counts fully.
    boundary : {"refreshed", "no_flux"}
        "refreshed": liquid nodes within the horizon of the domain's edge are held at zero
        concentration.  "no_flux": nothing crosses the edge.
    renewed : bool array of the lattice's shape, optional
        With "refreshed": the liquid nodes that are held at zero in the place of those at the edge.
    walls : bool
        Whether the liquid conducts beside walls as elsewhere (engine.walls); without it a layer of
        a horizon's width conducts less, which counts in gaps of a few horizons.
    pores : bool
        With dissolution "faradaic" and walls: what is gone of a metal node holds liquid like that
        beside it, and conducts along the wall (nodes.pores).  Without it a cell opens to the
        liquid when its metal is gone, and a gap is narrower by what has begun to dissolve.
    solid_concentration, saturation_concentration : float
        C_solid and C_sat, mol/m^3, 0 < C_sat < C_solid.
    liquid_diffusivity : float
        D_liq, m^2/s.
    interface_diffusivity : float, optional
        D_int at zero volume loss, m^2/s; either this or
    dissolution_flux : float, optional
        the flux i_0/(zF) of a flat front at zero volume loss into clean liquid, mol/(m^2 s), from
        which D_int follows for the stencil in use: flux = D_int C_solid S, S the stencil's
        front strength, so that lattice and horizon do not change the rate.
    flux_calibration : {"isotropic", "axis", "every_axis"}
        S as the mean over all orientations of the front (for bodies), or of a front along the
        lattice's axes (exact for a flat front that lies so).  "every_axis": bonds of their own
        across the interface, of the same strength along every axis (influence.front_stencil); on a
        stretched lattice those of diffusion differ by an order.
    dissolution : {"proportional", "faradaic"} or InterfaceLaw
        What an interface bond carries: D_int w (C_i - C_j), or the flux of Faraday's law,
        D_int w C_solid, until its metal node is empty (corrosion.laws).  A word becomes its law.
    kinetics : Kinetics
        How fast the interface dissolves; see corrosion.kinetics.
    detached : {"keep", "dissolve"}
        Metal that corrosion has cut off from the largest piece of what it belonged to: it goes on
        dissolving where it is, or turns liquid at once, up to C_sat in the liquid nearest to it;
        the rest leaves as debris (with what is released).  Cells then count fully.
    coating : Coating, optional
        What holds every interface back until it is gone, with any kinetics.
    kernel_exponent, influence, calibration :
        See influence.diffusion_stencil.
    saturation : {"complementarity", "as_published", "none"}
    exposure : rate_classes.CellExposure, optional
        Rate classes of the cells, for a solid whose surface is known: metal and liquid then share
        the cut cells, and rates are those of the surface, whatever the lattice (classes.volumes).
        Without it a node has one phase and one rate.
    solids, phase : tuple of Solid, uint8 array, optional
        The solids that the metal is made of and which of them (from 1; 0 off the metal) each node
        is; without them all metal is one solid of `solid_concentration`.

    Raises
    ------
    ValueError
        One sentence naming field, value and what is allowed.
    """

    lattice: Lattice
    horizon: float | tuple[float, ...]
    metal: np.ndarray = field(repr=False)
    domain: np.ndarray | None = field(default=None, repr=False)
    metal_fraction: np.ndarray | None = field(default=None, repr=False)
    boundary: str = "refreshed"
    solid_concentration: float = 1.0
    saturation_concentration: float = 0.5
    liquid_diffusivity: float = 1e-9
    interface_diffusivity: float | None = None
    dissolution_flux: float | None = None
    flux_calibration: str = "isotropic"
    dissolution: str | InterfaceLaw = "proportional"
    kinetics: Kinetics = ConstantRate()
    kernel_exponent: float = 0.0
    influence: str = "constant"
    calibration: str = "discrete"
    saturation: str = "complementarity"
    exposure: CellExposure | None = field(default=None, repr=False)
    solids: tuple[Solid, ...] = ()
    phase: np.ndarray | None = field(default=None, repr=False)
    coating: Coating | None = None
    detached: str = "keep"
    liquid: np.ndarray | None = field(default=None, repr=False)
    renewed: np.ndarray | None = field(default=None, repr=False)
    walls: bool = False
    pores: bool = False

    def __post_init__(self) -> None:
        shape = self.lattice.shape
        domain = np.ones(shape, bool) if self.domain is None else self.domain
        for name, value in (("metal", self.metal), ("domain", domain)):
            if value.shape != shape or value.dtype != bool:
                raise ValueError(f"{name}: {value.dtype} {value.shape}; it must be bool {shape}")
        object.__setattr__(self, "domain", domain)
        if np.any(self.metal & ~domain):
            raise ValueError("metal: it must lie inside the domain")
        if self.detached == "dissolve" and self.metal_fraction is not None:
            raise ValueError("detached: 'dissolve' with metal_fraction; its cells count fully")
        if self.metal_fraction is not None:
            fraction = self.metal_fraction
            if fraction.shape != shape or not (fraction.min() >= 0 and fraction.max() <= 1):
                raise ValueError(f"metal_fraction: it must be {shape} with values from 0 to 1")
        object.__setattr__(self, "dissolution", interface_law(self.dissolution))
        for name, allowed in (
            ("boundary", BOUNDARIES),
            ("saturation", SATURATION_MODELS),
            ("flux_calibration", FLUX_CALIBRATIONS),
            ("detached", DETACHED),
        ):
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name}: {getattr(self, name)!r}; allowed: {', '.join(allowed)}")
        if self.saturation not in self.dissolution.saturations:
            raise ValueError(
                f"saturation: {self.saturation!r} with dissolution {self.dissolution.name!r}; "
                f"allowed: {', '.join(self.dissolution.saturations)}"
            )
        if not isinstance(self.kinetics, Kinetics):
            raise ValueError(
                f"kinetics: {self.kinetics!r}; it must be a corrosion.kinetics.Kinetics"
            )
        for name in ("solid_concentration", "saturation_concentration", "liquid_diffusivity"):
            _check_positive(name, getattr(self, name))
        if not self.saturation_concentration < self.solid_concentration:
            raise ValueError(
                f"saturation_concentration: {self.saturation_concentration} mol/m3 must be below "
                f"solid_concentration {self.solid_concentration} mol/m3"
            )
        self._check_solids()
        self._check_liquid()
        if self.pores and not (self.walls and self.dissolution.name == "faradaic"):
            raise ValueError("pores: they need walls and dissolution 'faradaic'")
        if self.pores and self.detached == "dissolve":
            raise ValueError("pores: given with detached 'dissolve', which does not know them")
        if (self.interface_diffusivity is None) == (self.dissolution_flux is None):
            raise ValueError("interface_diffusivity, dissolution_flux: give exactly one of them")
        for name in ("interface_diffusivity", "dissolution_flux"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name}: {value}; it must be finite and not negative")
        if self.exposure is not None:
            self._check_exposure()
        if self.flux_calibration == "every_axis" and self.dissolution_flux is None:
            raise ValueError(
                "flux_calibration: 'every_axis' calibrates a dissolution_flux; give it"
            )
        object.__setattr__(self, "_stencil", self._make_stencil())
        bonds = self._stencil
        if self.flux_calibration == "every_axis":
            bonds = front_stencil(self.lattice, self.horizon, self.kernel_exponent, self.influence)
        object.__setattr__(self, "_interface_stencil", bonds)

    def _check_exposure(self) -> None:
        """What rate classes do not have is refused by name."""
        law = self.dissolution.name
        bounds = ("complementarity", "none") if law == "faradaic" else ("complementarity",)
        for name, there in (
            ("liquid", self.liquid is not None),
            ("renewed", self.renewed is not None),
            ("walls", self.walls),
            ("detached 'dissolve'", self.detached == "dissolve"),
            ("flux_calibration 'every_axis'", self.flux_calibration == "every_axis"),
        ):
            if there:
                raise ValueError(f"{name}: given with rate classes, which do not have it")
        for name, given, allowed in (
            ("dissolution", law, CLASS_LAWS),
            ("saturation", self.saturation, bounds),
        ):
            if given not in allowed:
                raise ValueError(
                    f"{name}: {given!r} with rate classes; allowed: {', '.join(allowed)}"
                )
        if self.solids != (Solid(self.solid_concentration),):
            raise ValueError("solids: several, or one that differs; rate classes have one")
        unknown = self.needs - {"volume_loss", "concentration", "age"}
        if unknown or not self.kinetics.on_classes:
            because = f"needs {', '.join(sorted(unknown))}" if unknown else "acts on nodes"
            raise ValueError(
                f"kinetics: {type(self.kinetics).__name__} {because}; rate classes have "
                "volume_loss, concentration and age, for laws that act on them"
            )
        if np.ndim(self.horizon) != 0 or self.exposure.metal.fraction.shape != self.lattice.shape:
            raise ValueError(
                f"exposure: classes of a lattice {self.exposure.metal.fraction.shape} and one "
                f"horizon; the scene has {self.lattice.shape} and {self.horizon} m"
            )
        if not np.array_equal(self.exposure.metal.fraction > 0, self.metal):
            raise ValueError(
                "metal: with rate classes it must be the cells that hold metal, "
                "exposure.metal.fraction > 0"
            )

    def _check_liquid(self) -> None:
        shape, most = self.lattice.shape, self.saturation_concentration
        if self.liquid is not None:
            there = self.domain & ~self.metal
            if self.liquid.shape != shape:
                raise ValueError(f"liquid: {self.liquid.shape}; the lattice has {shape}")
            start = self.liquid[there]
            if not (start.min(initial=0.0) >= 0 and start.max(initial=0.0) <= most):
                raise ValueError(
                    f"liquid: {start.min()} to {start.max()} mol/m^3; it must be from 0 to the "
                    f"saturation_concentration of {most} mol/m^3"
                )
        if self.renewed is not None:
            if self.renewed.shape != shape or self.renewed.dtype != bool:
                raise ValueError(
                    f"renewed: {self.renewed.dtype} {self.renewed.shape}; it must be bool {shape}"
                )
            if self.boundary != "refreshed":
                raise ValueError(f"renewed: given with boundary '{self.boundary}'")

    def _check_solids(self) -> None:
        object.__setattr__(self, "solids", self.solids or (Solid(self.solid_concentration),))
        if self.phase is not None:
            phase, highest = self.phase, len(self.solids)
            if phase.shape != self.metal.shape or phase.dtype != np.uint8:
                raise ValueError(f"phase: {phase.dtype} {phase.shape}; it must be uint8 on nodes")
            if not np.array_equal(phase > 0, self.metal) or phase.max(initial=0) > highest:
                raise ValueError(f"phase: from 1 to {highest} on the metal, 0 elsewhere, wanted")
        elif len(self.solids) > 1:
            raise ValueError("phase: it must say which of the solids each metal node is")
        lowest = min(solid.concentration for solid in self.solids)
        if not self.saturation_concentration < lowest:
            raise ValueError(f"solids: concentration {lowest} mol/m3 must exceed C_sat")
        if not self.needs <= set(QUANTITIES):
            unknown = ", ".join(sorted(self.needs - set(QUANTITIES)))
            raise ValueError(f"kinetics: it needs {unknown}; known: {', '.join(QUANTITIES)}")

    def law_of(self, solid: Solid) -> Kinetics:
        """The kinetics of a solid."""
        return solid.kinetics or self.kinetics

    @property
    def needs(self) -> frozenset[str]:
        """What the kinetics of all solids look at."""
        return frozenset().union(*(self.law_of(solid).needs for solid in self.solids))

    @property
    def one_rate(self) -> bool:
        """Whether one number, given by the volume loss, is the rate of all metal."""
        only = self.solids[0]
        plain = len(self.solids) == 1 and only == Solid(self.solid_concentration)
        return plain and self.kinetics.is_global

    @property
    def never_speeds_up(self) -> bool:
        """Whether the rate at zero volume loss bounds that of all metal from above."""
        return self.one_rate and self.kinetics.never_speeds_up

    @property
    def highest_concentration(self) -> float:
        """The largest C_solid, mol/m^3."""
        return max(solid.concentration for solid in self.solids)

    def phases(self) -> np.ndarray:
        """Number of each node's solid (from 1; 0 off the metal), uint8."""
        return self.metal.astype(np.uint8) if self.phase is None else self.phase

    def solid_concentrations(self) -> np.ndarray:
        """C_solid of each node's solid, mol/m^3; 0 off the metal."""
        table = np.array([0.0, *(solid.concentration for solid in self.solids)])
        return table[self.phases()]

    def bare_time(self, times: ArrayLike) -> np.ndarray:
        """Times (s) as bare metal in clean liquid would need them to be as far; see Coating."""
        return np.asarray(times, float) if self.coating is None else self.coating.bare_time(times)

    def _make_stencil(self) -> Stencil:
        return diffusion_stencil(
            self.lattice, self.horizon, self.kernel_exponent, self.influence, self.calibration
        )

    @property
    def stencil(self) -> Stencil:
        """Bond weights of unit diffusivity."""
        return self._stencil

    def cut_cell_bonds(self, front: FlatFront) -> ShareBonds:
        """Bonds between the shares of cells that a moving surface cuts, 1/m^2."""
        from peri.engine.surface.share_weights import share_bonds  # loads scipy.optimize

        return share_bonds(self.stencil, front, self.dissolution.by_layers)

    def nearest_stencil(self) -> Stencil:
        """Weights 1 of the next cells along each axis, on an octant like the stencil's."""
        return nearest_of(self.stencil)

    @property
    def interface_stencil(self) -> Stencil:
        """Bond weights across the interface, of unit interface diffusivity."""
        return self._interface_stencil

    def base_interface_diffusivity(self) -> float:
        """D_int at zero volume loss, m^2/s, given or derived from the dissolution flux."""
        if self.interface_diffusivity is not None:
            return self.interface_diffusivity
        if self.exposure is not None:
            strength = closed_strength(self.horizon, self.kernel_exponent, self.influence)
            return self.dissolution_flux / (self.solid_concentration * strength)
        return self.dissolution_flux / (
            self.solid_concentration * front_strength(self.interface_stencil, self.flux_calibration)
        )

    def refreshed(self) -> np.ndarray:
        """Liquid nodes held at zero: those within the horizon of the domain's edge, or named."""
        if self.boundary == "no_flux":
            return np.zeros(self.lattice.shape, bool)
        if self.renewed is not None:
            return self.renewed & self.domain & ~self.metal
        from scipy.ndimage import distance_transform_edt

        padded = np.pad(self.domain, 1)
        depth = distance_transform_edt(padded, sampling=self.lattice.spacing)
        depth = depth[(slice(1, -1),) * self.lattice.dimension]
        # A node's distance to the first missing node is its distance to the edge plus h/2.
        width = np.max(self.horizon) + 0.5 * min(self.lattice.spacing)
        return self.domain & ~self.metal & (depth < width * (1 - 1e-9))

    def start_liquid(self) -> np.ndarray:
        """Concentration of the liquid at the start, mol/m^3; 0 off it and where it is held."""
        if self.liquid is None:
            return np.zeros(self.lattice.shape)
        return np.where(self.domain & ~self.metal & ~self.refreshed(), self.liquid, 0.0)

    def capacity(self) -> np.ndarray:
        """Volume of each cell relative to the lattice's, by the phase of its node.

        A cut cell has one phase, its node's; what the other phase owns of it is handed to the
        neighbouring cells of that phase.  The metal's total is exactly sum(metal_fraction) cells.
        Read-only.
        """
        return self._capacity

    @functools.cached_property
    def _capacity(self) -> np.ndarray:
        out = self._make_capacity()
        out.flags.writeable = False
        return out

    def _make_capacity(self) -> np.ndarray:
        if self.exposure is not None:
            fraction = self.exposure.metal.fraction
            return np.where(self.metal, fraction, np.where(self.domain, 1.0 - fraction, 0.0))
        if self.metal_fraction is None:
            return self.domain.astype(float)
        metal, liquid = self.metal, self.domain & ~self.metal
        share = np.where(self.domain, self.metal_fraction, 0.0)
        out = np.where(metal, share, 0.0) + hand_over(np.where(liquid, share, 0.0), metal)
        total = share.sum()
        if metal.any() and total > 0:
            out = np.where(metal, np.maximum(out, 0.05), 0.0)
            out *= total / out.sum()
        rest = np.where(self.domain, 1.0 - share, 0.0)
        return out + np.where(liquid, rest, 0.0) + hand_over(np.where(metal, rest, 0.0), liquid)


def nearest_of(stencil: Stencil) -> Stencil:
    """Weights 1 of the next nodes along each axis, on an octant of a stencil's size."""
    octant = np.zeros(stencil.octant.shape)
    for axis in np.eye(stencil.dimension, dtype=int):
        octant[tuple(axis)] = 1.0
    return Stencil(octant, stencil.spacing)


def front_strength(stencil: Stencil, flux_calibration: str) -> float:
    """The strength S that turns a dissolution flux into D_int C_solid S, 1/m."""
    if flux_calibration == "isotropic":
        return stencil.mean_strength()
    return float(np.mean([stencil.front_strength(a) for a in range(stencil.dimension)]))


def _check_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name}: {value}; it must be finite and positive")
