"""A galvanic couple: metals joined by a wire, or touching, in a liquid that conducts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from peri.corrosion.kinetics import ConstantRate, Kinetics
from peri.coupled.galvanic_ions import Ions
from peri.engine.influence import Stencil, diffusion_stencil
from peri.engine.lattice import Lattice
from peri.transport.potential.polarization import Polarization

ROBIN = ("conservative", "as_published")
"""How a law is joined to the liquid: by bonds that carry its current, or by mirror nodes."""
MOST_MIRRORED = {1: 200_000, 2: 200_000, 3: 15_000}
"""Liquid nodes by dimension that mirror nodes are solved for, which is done directly: about 1 GB of
factors, ten times that for ten times as many."""


@dataclass(frozen=True)
class Metal:
    """One metal of a couple.

    Parameters
    ----------
    name : str
    nodes : bool array of the lattice's shape
    law : Polarization
        i(E), such as those of corrosion.polarization.
    solid_concentration : float, optional
        mol/m^3 of what dissolves; without it the metal carries current but stays as it is.
    charge_number : float, optional
        z of its ion; a metal that dissolves needs one.
    potential : float
        Of the metal, V: metals of equal potential are joined by a wire, others by a source.
    self_corrosion : float
        A/m^2, >= 0: what dissolves of a fresh surface without any couple, driven by hydrogen that
        the same surface sets free; it enters no liquid as a current.
    kinetics : Kinetics
        How self-corrosion changes with the metal's volume loss (its lost share).

    Raises
    ------
    ValueError
        For numbers out of range, a metal that dissolves without a charge number, self-corrosion
        of a metal that does not dissolve, or by a law of something else than the volume loss.
    """

    name: str
    nodes: np.ndarray = field(repr=False)
    law: Polarization
    solid_concentration: float | None = None
    charge_number: float | None = None
    potential: float = 0.0
    self_corrosion: float = 0.0
    kinetics: Kinetics = ConstantRate()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.self_corrosion) and self.self_corrosion >= 0):
            raise ValueError(
                f"self_corrosion: {self.self_corrosion} A/m^2 of '{self.name}'; it must be finite "
                "and not negative"
            )
        if self.self_corrosion and self.solid_concentration is None:
            raise ValueError(
                f"self_corrosion: {self.self_corrosion} A/m^2 of '{self.name}', which does not "
                "dissolve; give its solid_concentration"
            )
        if not self.kinetics.is_global:
            raise ValueError(
                f"kinetics: {type(self.kinetics).__name__} of '{self.name}'; self-corrosion goes "
                "by the volume loss alone"
            )
        if self.solid_concentration is not None:
            if self.charge_number is None:
                raise ValueError(
                    f"charge_number: none is given for '{self.name}'; a metal that dissolves "
                    "needs the charge of its ion"
                )
            for name in ("solid_concentration", "charge_number"):
                value = getattr(self, name)
                if not (math.isfinite(value) and value > 0):
                    raise ValueError(
                        f"{name}: {value} of '{self.name}'; it must be finite and positive"
                    )
        if not math.isfinite(self.potential):
            raise ValueError(f"potential: {self.potential} V of '{self.name}'; it must be finite")


@dataclass(frozen=True)
class GalvanicScene:
    """Metals in a conducting liquid on a lattice.

    Every metal has its lead: the largest part of what is left of it carries current, smaller
    islands do not.  All that is no metal is liquid; the edges of the lattice insulate.

    Parameters
    ----------
    lattice : Lattice
    horizon : float or one per axis
        m.
    metals : tuple of Metal
    conductivity : float, or float array of the lattice's shape
        kappa of the liquid, S/m, > 0; of a field also where metal will be liquid.  By the ions of
        a given concentration: transport.potential.conductivity.
    held : float array of the lattice's shape, optional
        phi of liquid nodes that are held, V; NaN elsewhere.
    calibration : see influence.diffusion_stencil.
    robin : {"conservative", "as_published"}
        The bonds of transport.potential.electrostatics, or the mirror nodes of Zhao et al. 2021,
        Appendix A, corrected (transport.potential.mirror), on a lattice of one spacing with one
        conductivity and no held nodes: to be compared with, since by the law their currents do
        not balance.
    ions : Ions, optional
        The metals' ions in the liquid, by which that conducts; `conductivity` is then one number,
        of clean liquid.  Without them it stays as it is.

    Raises
    ------
    ValueError
        One sentence naming field, value and what is allowed.
    """

    lattice: Lattice
    horizon: float | tuple[float, ...]
    metals: tuple[Metal, ...]
    conductivity: float | np.ndarray
    held: np.ndarray | None = field(default=None, repr=False)
    calibration: str = "discrete"
    robin: str = ROBIN[0]
    ions: Ions | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "metals", tuple(self.metals))
        names = [metal.name for metal in self.metals]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"metals: {', '.join(names) or 'none'}; each needs its own name")
        kappa = np.asarray(self.conductivity, float)
        if kappa.ndim and kappa.shape != self.lattice.shape:
            raise ValueError(f"conductivity: {kappa.shape}; the lattice has {self.lattice.shape}")
        if not (np.isfinite(kappa).all() and kappa.min() > 0):
            raise ValueError(f"conductivity: {kappa.min()} S/m; it must be finite and positive")
        taken = np.zeros(self.lattice.shape, np.int64)
        for metal in self.metals:
            if metal.nodes.shape != self.lattice.shape or metal.nodes.dtype != bool:
                raise ValueError(
                    f"metals: '{metal.name}' is {metal.nodes.dtype} of {metal.nodes.shape}; bool "
                    f"of {self.lattice.shape} wanted"
                )
            if not metal.nodes.any():
                raise ValueError(f"metals: '{metal.name}' has no node on this lattice")
            taken += metal.nodes
        if (taken > 1).any():
            raise ValueError(
                f"metals: {int((taken > 1).sum())} nodes belong to two of {', '.join(names)}, "
                "which overlap"
            )
        if self.held is not None and self.held.shape != self.lattice.shape:
            raise ValueError(f"held: {self.held.shape}; the lattice has {self.lattice.shape}")
        self._check_robin()
        if self.ions is not None:
            self.ions.check(self.lattice.shape, self.conductivity)
        object.__setattr__(
            self,
            "_stencil",
            diffusion_stencil(self.lattice, self.horizon, calibration=self.calibration),
        )

    def _check_robin(self) -> None:
        if self.robin not in ROBIN:
            raise ValueError(f"robin: '{self.robin}'; it must be one of {', '.join(ROBIN)}")
        if self.robin == ROBIN[0]:
            return
        spacing = self.lattice.spacing
        count, most = int((~self.metal()).sum()), MOST_MIRRORED[self.lattice.dimension]
        for there, what in (
            (np.ndim(self.conductivity) > 0, "one conductivity, not a field"),
            (self.held is not None, "no held nodes"),
            (self.ions is not None, "no ions in the liquid"),
            (max(spacing) > min(spacing) * (1 + 1e-9), "one spacing along all axes"),
            (count > most, f"at most {most:,} nodes of liquid, not {count:,}"),
        ):
            if there:
                raise ValueError(f"robin: '{self.robin}'; mirror nodes take {what}")

    @property
    def stencil(self) -> Stencil:
        """Bond weights of unit conductivity."""
        return self._stencil

    def metal(self) -> np.ndarray:
        """Nodes that are metal at the start, bool."""
        return np.any([metal.nodes for metal in self.metals], axis=0)

    def conducts(self, content: np.ndarray | None) -> float | np.ndarray:
        """kappa of the liquid, S/m, that holds so much of the metals (mol/m^3; None: no ions)."""
        if self.ions is None or content is None:
            return self.conductivity
        return self.ions.conducts(content)

    def phases(self) -> np.ndarray:
        """Number of each node's metal, from 1; 0 in the liquid; uint8."""
        out = np.zeros(self.lattice.shape, np.uint8)
        for number, metal in enumerate(self.metals, 1):
            out[metal.nodes] = number
        return out

    def solid_concentrations(self) -> np.ndarray:
        """C_solid of each node of a metal that dissolves, mol/m^3; 0 elsewhere."""
        out = np.zeros(self.lattice.shape)
        for metal in self.metals:
            out[metal.nodes] = metal.solid_concentration or 0.0
        return out
