"""Anodes and cathodes of one metal that lie apart: its potential, and what they give the liquid.

The metal conducts far better than any liquid, so it has one potential E_m; a node's own is E_m -
phi, phi the liquid's beside it.  With a_i and c_i the rates of anode and cathode (corrosion.
electrode_kinetics) and U_i what the bonds of node i release at rate 1 (mol/s),

    mixed      sum_i U_i (a_i - c_i) = 0                 the corrosion potential, free
    applied    E_m given, or sum_i U_i (a_i - c_i) = I / (2 F)

and a node gives the liquid U_i a_i Mg2+ and 2 U_i c_i OH-: together they carry a charge, which the
ions' potential drives to where it is taken up.  With `applied` the rest of it leaves through the
refreshed layer, where phi = 0 and the counter electrode stands beyond.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import brentq

from peri.corrosion.electrode_kinetics import ElectrodeKinetics
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.scene import CorrosionScene
from peri.coupled.feedback import Agreement
from peri.coupled.ohmic import Ohmic
from peri.coupled.surroundings import MAGNESIUM, Surroundings
from peri.engine.constants import FARADAY
from peri.engine.processes import OneProcess
from peri.transport.liquid import LiquidSpace, LiquidState

ELECTRONS = MAGNESIUM["OH"]
"""Per metal atom."""

_REACH = 20.0
"""V about the laws' own potentials within which the metal's is looked for."""

_RESISTS = 1e-3
"""V of the liquid's potential along the metal below which the drop is left to the rounds alone."""

Seen = dict[str, np.ndarray]


class ChargeBalance:
    """What joins the anodes and cathodes of a scene's metal.

    laws : of its solids, in order.

    Raises
    ------
    ValueError
        For solids with different balances.
    """

    def __init__(self, scene: CorrosionScene, laws: list[ElectrodeKinetics]) -> None:
        self.scene, self.laws = scene, laws
        how = {(law.balance, law.applied_potential, law.applied_current) for law in laws}
        if len(how) > 1:
            raise ValueError("balance: the solids of one metal must have the same")
        self.balance, self.potential, self.current = how.pop()

    @classmethod
    def of(cls, scene: CorrosionScene) -> ChargeBalance | None:
        """That of a scene; None where every node balances its own charge or has no electrodes.

        Raises ValueError where only some of the solids have electrodes.
        """
        laws = [scene.law_of(solid) for solid in scene.solids]
        electrodes = [law for law in laws if isinstance(law, ElectrodeKinetics)]
        if all(law.balance == "local" for law in electrodes):
            return None
        if len(electrodes) < len(laws):
            raise ValueError(
                "kinetics: some solids of the metal have electrodes and others none; all of them "
                "must, or each node balances its own charge (balance 'local')"
            )
        return cls(scene, electrodes)

    def check(self, closure: str, bath: bool, is_open: bool) -> None:
        """Refuse what no current can go through: ValueError."""
        if self.balance == "applied" and not is_open:
            raise ValueError(
                "balance: 'applied' in a closed vessel, which no current leaves; it needs a "
                "refreshed boundary"
            )
        if closure not in ("electroneutral", "poisson"):
            raise ValueError(
                f"closure: '{closure}' with balance '{self.balance}', whose current needs a "
                "potential; allowed are electroneutral, poisson"
            )
        if bath and self.balance == "applied":
            raise ValueError(
                "balance: 'applied' with a bath of finite volume, which the counter electrode "
                "would change; leave the bath's volume out"
            )

    def rates(self, phase: np.ndarray, seen: Seen) -> tuple[np.ndarray, np.ndarray]:
        """Shares of anode and cathode of nodes whose solid is `phase` (0: none), by `seen`."""
        scene, anodic, cathodic = self.scene, np.zeros(phase.shape), np.zeros(phase.shape)
        for number, (solid, law) in enumerate(zip(scene.solids, self.laws, strict=True), 1):
            of = phase == number
            there = (np.broadcast_to(seen[n], of.shape)[of] for n in _READ)
            share = scene.dissolution.share_of(solid, scene)
            anodic[of], cathodic[of] = (share * rate for rate in law.rates(*there))
        return anodic, cathodic

    def strengths(
        self, around: Surroundings, concentration: np.ndarray, theta: np.ndarray | None
    ) -> np.ndarray:
        """U_i over the volume of a cell, padded box array, mol/m3/s times relative volume."""
        discrete = around.discrete
        values = discrete.take(concentration)
        bonds = discrete.take(around.space.spread(around.space.volume))
        if theta is not None:
            bonds = bonds * theta
        liquid = np.where(discrete.box_metal, 0.0, values)
        drawn = values * discrete.box(bonds) - discrete.box(bonds * liquid)
        return discrete.base_diffusivity * discrete.box_metal_volume * around.switch * drawn

    @property
    def rest(self) -> float:
        """The potential that is held, or that the first solid has by itself in the medium, V."""
        if self.potential is not None:
            return self.potential
        return float(self.laws[0].corrosion_potential(self.laws[0].ph_reference, 0.0))

    @property
    def wanted(self) -> float:
        """Moles of metal that leave their electrons to the current, over a cell's volume, 1/s."""
        return (self.current or 0.0) / (ELECTRONS * FARADAY * self.scene.lattice.cell_volume)

    def agreement(self, discrete: BiMaterial, seen: Seen) -> Agreement:
        """Rounds of a stage; a current that the liquid cannot carry goes back towards none."""
        phase, own = discrete.box_phase, np.array(seen["potential"])
        for number, law in enumerate(self.laws, 1):
            of = phase == number
            own[of] = law.corrosion_potential(seen["ph"][of], seen["magnesium"][of])
        return Agreement(
            discrete, seen, lambda values, _: self.rates(phase, values), {**seen, "potential": own}
        )

    def begin(self, around: Surroundings) -> None:
        """Give the kinetics the potential that the metal has in the medium at first."""
        discrete = around.discrete
        clean = {"liquid_potential": 0.0, **discrete.surface}
        discrete.surface["potential"], _ = self.find(
            around, discrete.initial_concentration, None, clean
        )

    def find(
        self,
        around: Surroundings,
        concentration: np.ndarray,
        theta: np.ndarray | None,
        beside: Mapping[str, np.ndarray | float],
        read: Seen | None = None,
        liquid: LiquidState | None = None,
    ) -> tuple[float, np.ndarray]:
        """E_m (V) and every node's potential, for what is beside the metal.

        beside : as feedback.beside_metal gives it of `liquid`, found with the currents by `read`.
        Other currents bring another phi (ohmic.py), without which the rounds of a liquid that
        resists (a drop well above the laws' RT/F) would not settle.
        """
        discrete = around.discrete
        strengths = self.strengths(around, concentration, theta)
        of = strengths > 0
        if not discrete.processes.any(of.any()):  # no metal is left
            return self.rest, np.full(of.shape, self.rest)
        phi = np.broadcast_to(beside["liquid_potential"], of.shape)
        surface = _Surface(
            self, discrete.processes, strengths[of], discrete.box_phase[of], _on(of, beside),
            phi[of],
        )  # fmt: skip
        if read is None or surface.drop <= _RESISTS:
            metal = surface.potential(surface.phi)
            return metal, metal - phi
        ohmic = Ohmic(around, liquid, of, ELECTRONS * surface.strengths)
        held = self.potential is not None
        metal, own = ohmic.answer(
            surface.net, _on(of, read)["potential"], surface.phi, surface.potential,
            None if held else ELECTRONS * self.wanted,
        )  # fmt: skip
        potential = metal - phi
        potential[of] = own
        return metal, potential

    def give(self, around: Surroundings, fields: Mapping[str, np.ndarray]) -> np.ndarray:
        """Give the liquid the charge of a state's fields; returns it as `charge` does."""
        surface, chemistry = around.discrete.surface, around.liquid.chemistry
        charge = self.charge(
            around, fields["concentration"], fields.get("theta"),
            {n: np.asarray(surface[n]) for n in _READ},
        )  # fmt: skip
        # A missing cathode is OH- that is not set free.
        hydroxide = chemistry.stoichiometry[chemistry.index("OH")]
        around.liquid.beside = np.multiply.outer(-hydroxide, charge)
        return charge

    def charge(
        self,
        around: Surroundings,
        concentration: np.ndarray,
        theta: np.ndarray | None,
        seen: Seen,
    ) -> np.ndarray:
        """Charge that the metal gives to each node of the liquid, mol/m3/s, (n,).

        Where the potential is free, a last difference between the potential that was read and
        that of the stage is spread over the cathodes, so that the whole is exact.
        """
        anodic, cathodic = self.rates(around.discrete.box_phase, seen)
        net, total = anodic - cathodic, around.discrete.processes.total
        if self.potential is None:
            strengths = self.strengths(around, concentration, theta)
            whole = total(float(strengths.sum()))
            if whole > 0:
                net = net - (total(float((strengths * net).sum())) - self.wanted) / whole
        rate = around.discrete.base_diffusivity
        return ELECTRONS * around.inflow(concentration, theta, rate, net)


class _Surface:
    """The nodes that liquid sees, (k,): strengths U, number of their solid, and what they see.

    processes : that have them; sums are over all.
    """

    def __init__(
        self, of: ChargeBalance, processes: OneProcess, strengths: np.ndarray, phase: np.ndarray,
        seen: Seen, phi: np.ndarray,
    ) -> None:  # fmt: skip
        self.of, self.strengths, self.phase, self.seen, self.phi = of, strengths, phase, seen, phi
        self._processes = processes

    @property
    def drop(self) -> float:
        """Between the highest and the lowest phi, V."""
        largest, phi = self._processes.largest, self.phi
        highest = largest(float(phi.max(initial=-np.inf)))
        return highest + largest(-float(phi.min(initial=np.inf)))

    def _sum(self, of_nodes: np.ndarray) -> float:
        return self._processes.total(float(self.strengths @ of_nodes))

    def net(self, potential: np.ndarray) -> np.ndarray:
        """Anode less cathode of every node."""
        anodic, cathodic = self.of.rates(self.phase, {**self.seen, "potential": potential})
        return anodic - cathodic

    def potential(self, phi: np.ndarray) -> float:
        """E_m, V: held, or that which balances the currents where the liquid has phi (k,)."""
        of = self.of
        if of.potential is not None:
            return of.potential

        def excess(metal: float) -> float:
            return self._sum(self.net(metal - phi)) - of.wanted

        own = [v for law in of.laws for v in (law.potential, law.hydrogen_potential)]
        low, high = min(own) - _REACH, max(own) + _REACH
        return float(brentq(excess, low, high, xtol=1e-15, rtol=1e-15))


_READ = ("potential", "ph", "magnesium")


def _on(of: np.ndarray, seen: Mapping[str, np.ndarray | float]) -> Seen:
    return {n: np.broadcast_to(seen[n], of.shape)[of] for n in _READ if n in seen}


def check_one_piece(space: LiquidSpace) -> None:
    """Raise ValueError for liquid in parts that neither bonds nor the refreshed layer join."""
    reached = space.exit > 0
    if not space.any(reached):
        reached[:1] = space.processes.first(space.n > 0)
    apart = space.count(~space.joined_to(reached))
    if apart:
        raise ValueError(
            f"balance: {apart} nodes of the liquid are cut off from the rest, so that no current "
            "joins their anodes and cathodes; use 'local'"
        )
