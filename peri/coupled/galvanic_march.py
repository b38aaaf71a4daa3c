"""The march of a galvanic couple: solve the potential, dissolve what its currents carry, repeat.

With the metals as they are, the liquid's potential and the current of every patch follow
(transport.potential.electrostatics).  A patch of a metal that dissolves draws

    dC_i/dt = -s_i I / (z F dV),   I its current, sum_i s_i = 1,

from the nodes behind it, along the bonds that carry the current (Zhao et al. 2021, Eqs 16 to 20,
with a sign; the sum over the actual family instead of its flat-front value).  A node that is empty
is liquid.  So the metal loses what the current carries, to round-off, and a flat front travels at
i / (z F C_solid).  Self-corrosion adds a current density of its own to each patch, which leaves
the potential alone.

The surface that the potential sees lies deeper than the exposed nodes by what the patch has lost
already, sum_i (1 - C_i / C_solid) dV / A, so that the potential of a flat front changes steadily
and not by steps of the lattice.

Where a scene follows its ions (galvanic_ions), what the metals lose enters the liquid along the
bonds that carry the current, and the conductivity is renewed with the potential.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import ndimage

from peri.corrosion.kinetics import Exposed
from peri.coupled.galvanic_ions import IonTransport
from peri.coupled.galvanic_scene import GalvanicScene
from peri.coupled.patch_queues import drain, spill
from peri.engine.constants import FARADAY
from peri.engine.march.checkpoints import fingerprint
from peri.engine.march.problem import Course, Fields, Problem, State, moment
from peri.transport.potential.electrostatics import (
    Electrode,
    NoSinkError,
    PotentialField,
    PotentialProblem,
)
from peri.transport.potential.mirror import MirrorProblem
from peri.transport.potential.polarization import Insulated

_OF_IONS = {
    "ions_amount": "mol",
    "released_amount": "mol",
    "balance_error": "1",
    "highest_ions": "mol/m3",
    "salt_amount": "mol",
    "highest_conductivity": "S/m",
}
_JUMP = 0.2
"""Change of a current in a step that still counts as a trend, relative."""


class GalvanicProblem(Problem):
    """A galvanic scene, ready to be marched.

    Fields of its states: `concentration` (mol/m^3, of the lattice's shape), `lead` (bool: metal
    that is not cut off), `potential` (of the liquid, V), `density` and `surface` (A/m^2 and V of
    each patch), and `ions` (mol/m^3, what a node of liquid holds of the metals) where the scene
    follows them.  Numbers: `charge` (C, of the metals that dissolve), `moles` (it over z F),
    `released` (mol, what left in renewed liquid), `initial` and `current0`, `current1`, ... (A) of
    the metals.
    """

    def __init__(
        self,
        scene: GalvanicScene,
        tolerance: float = 1e-9,
        one_level: bool = False,
        between: Callable[..., PotentialProblem] = PotentialProblem,
    ) -> None:
        self.scene, self.tolerance, self.one_level = scene, tolerance, one_level
        self._solves = between
        self.solid = scene.solid_concentrations()
        self._label = scene.phases()
        self._grows = self.solid > 0
        self._place = np.stack([x.ravel() for x in np.broadcast_arrays(
            *scene.lattice.coordinates())], axis=1)  # fmt: skip
        zs = [metal.charge_number or np.inf for metal in scene.metals]
        self._charge = FARADAY * np.array(zs)  # C/mol
        self._dissolves = np.array([m.solid_concentration is not None for m in scene.metals])
        self._problem: tuple[bytes, PotentialProblem | None] = (b"", None)
        self.transport = (
            None if scene.ions is None else IonTransport(scene.ions, scene.lattice, scene.stencil)
        )
        self.columns = {
            "charge": "C",
            "metal_amount": "mol",
            "faraday_error": "1",
            "imbalance": "1",
            "dissolved_nodes": "1",
            "newton": "1",
            **{f"current_{metal.name}": "A" for metal in scene.metals},
            **(_OF_IONS if self.transport is not None else {}),
        }

    def key(self) -> str:
        """Hash of the scene and of how its potential is found."""
        return fingerprint(self.scene, self.tolerance, self.one_level)

    # --- the potential --------------------------------------------------------------------

    def metal(self, concentration: np.ndarray) -> np.ndarray:
        """Nodes that are metal: those that do not dissolve, and those that are not empty."""
        return (self._label > 0) & (~self._grows | (concentration > 0))

    def still_led(self, lead: np.ndarray) -> np.ndarray:
        """Of each part that a metal had at the start, the largest piece of what had its lead."""
        every_way = np.ones((3,) * lead.ndim, bool)
        out = np.zeros(lead.shape, bool)
        for number in range(1, len(self.scene.metals) + 1):
            parts, count = ndimage.label(self._label == number, every_way)
            left, pieces = ndimage.label((self._label == number) & lead, every_way)
            for part in range(1, count + 1):
                sizes = np.bincount(left[parts == part], minlength=pieces + 1)
                sizes[0] = 0
                if sizes.any():
                    out |= left == sizes.argmax()
        return out

    def potential_problem(self, fields: Fields) -> PotentialProblem | None:
        """Of the present phases; None where no metal that has its lead touches the liquid."""
        metal, lead = self.metal(fields["concentration"]), fields["lead"]
        mark = np.packbits(metal).tobytes() + np.packbits(lead).tobytes()
        if mark != self._problem[0]:
            scene, problem = self.scene, None
            if (ndimage.binary_dilation(~metal) & lead).any():
                electrodes = [
                    Electrode(lead & (self._label == number), solid.law, solid.potential)
                    for number, solid in enumerate(scene.metals, 1)
                ]
                ions = fields.get("ions")
                try:
                    problem = self._between(metal, electrodes, ions)
                except NoSinkError:
                    if np.array_equal(metal, self._label > 0):
                        raise
                    # What is left of the couple no longer is one; its metals go on by themselves.
                    problem = self._between(
                        metal, [replace(e, law=Insulated()) for e in electrodes], ions
                    )
            self._problem = mark, problem
        return self._problem[1]

    def _between(
        self, metal: np.ndarray, electrodes: list[Electrode], ions: np.ndarray | None
    ) -> PotentialProblem:
        """The potential problem of electrodes in all that is no metal."""
        scene = self.scene
        draws = any(not isinstance(electrode.law, Insulated) for electrode in electrodes)
        if scene.robin == "as_published" and draws:
            return MirrorProblem(
                scene.lattice, scene.stencil, ~metal, electrodes, float(scene.conductivity)
            )
        return self._solves(
            scene.lattice, scene.stencil, ~metal, electrodes, scene.conducts(ions), held=scene.held
        )

    def recession(self, problem: PotentialProblem, concentration: np.ndarray) -> np.ndarray:
        """How far behind its exposed face the mass of each patch's metal begins, m."""
        share = np.where(self._grows, 1.0 - concentration / np.where(self._grows, self.solid, 1), 0)
        behind = (problem.patches.drawn > 0) @ share.ravel()
        _, body = self._bodies(problem)
        area = np.bincount(body, problem.patches.area)[body]
        return behind * self.scene.lattice.cell_volume / area

    def solve(self, fields: Fields, guess: np.ndarray | None) -> PotentialField:
        """Potential and currents of a state's metal; guess: phi of the time before, V.

        Raises ValueError where no metal touches the liquid, and where a metal's potential lies
        outside the points of its measured curve.
        """
        problem = self.potential_problem(fields)
        if problem is None:
            raise ValueError("metals: none of them touches the liquid")
        if self.transport is not None:
            problem.conduct(np.asarray(self.scene.conducts(fields["ions"])))
        problem.recede(self.recession(problem, fields["concentration"]))
        if self.one_level:
            found = problem.level()
        else:
            found = problem.solve(guess=guess, tolerance=self.tolerance)
        for number, electrode in enumerate(problem.electrodes):
            check = getattr(electrode.law, "check_range", None)
            if check is not None:
                check(found.surface[found.patches.electrode == number])
        return found

    def _with_potential(self, state: State) -> tuple[State, int]:
        """A state with the potential of its metal, and the linear iterations that took."""
        if self._ended(state.fields):
            return self._at_rest(state), 0
        guess = state.fields.get("potential")
        if guess is not None:
            # Nodes that are liquid since then start from the nearest that were before.
            known = np.isfinite(guess)
            near = ndimage.distance_transform_edt(~known, return_indices=True)[1]
            guess = guess[tuple(near)] if known.any() else None
        found = self.solve(state.fields, guess)
        state.fields |= {
            "potential": found.potential,
            "density": found.density,
            "surface": found.surface,
            "receded": self.recession(self._known_problem(), state.fields["concentration"]),
        }
        state.numbers |= {"imbalance": found.imbalance, "newton": float(found.newton)}
        for n in range(len(self.scene.metals)):
            state.numbers[f"current{n}"] = found.current(n)
        return state, found.iterations

    def _ended(self, fields: Fields) -> bool:
        """Whether no more than one of several metals has anything left: a couple no more."""
        left = [(fields["lead"] & metal.nodes).any() for metal in self.scene.metals]
        alone = sum(left) <= 1 < len(left) and self.scene.held is None
        return alone or self.potential_problem(fields) is None

    def _at_rest(self, state: State) -> State:
        problem = self.potential_problem(state.fields)
        nothing = np.zeros(0 if problem is None else len(problem.patches.area))
        phi = np.full(self.scene.lattice.shape, np.nan)
        state.fields |= {
            "potential": phi, "density": nothing, "surface": nothing * np.nan, "receded": nothing,
        }  # fmt: skip
        state.numbers |= {"imbalance": 0.0, "newton": 0.0}
        state.numbers |= {f"current{n}": 0.0 for n in range(len(self.scene.metals))}
        return state

    # --- states ---------------------------------------------------------------------------

    def initial(self) -> State:
        """All metal there, and the potential of that."""
        amount = float(self.solid.sum()) * self.scene.lattice.cell_volume
        numbers = {
            "charge": 0.0, "moles": 0.0, "released": 0.0, "initial": amount, "dissolved": 0.0,
        }  # fmt: skip
        return self._with_potential(State(0.0, self.untouched(), numbers))[0]

    def untouched(self) -> Fields:
        """All metal there, all of it with its lead."""
        metal = self._label > 0
        fields = {"concentration": self.solid.copy(), "lead": self.still_led(metal)}
        if self.transport is not None:
            fields["ions"] = np.zeros(self.scene.lattice.shape)
        return fields

    def _of_metals(self, state: State) -> list[float]:
        """Self-corrosion of each metal at its present volume loss, A/m^2."""
        found = []
        for metal in self.scene.metals:
            now = metal.self_corrosion
            if now:
                whole = metal.solid_concentration * float(metal.nodes.sum())
                left = float(state.fields["concentration"][metal.nodes].sum())
                now *= float(metal.kinetics.rate(Exposed(1.0 - left / whole)))
            found.append(now)
        return found

    def rates(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What each patch dissolves, mol/s, by the couple and by itself; its recession, m/s."""
        problem = self.potential_problem(state.fields)
        if problem is None:
            return np.zeros(0), np.zeros(0), np.zeros(0)
        of, area = problem.patches.electrode, problem.patches.area
        goes = np.where(self._dissolves[of], np.maximum(state.fields["density"], 0.0), 0.0)
        alone = np.array(self._of_metals(state))[of]
        solids = np.array([m.solid_concentration or np.inf for m in self.scene.metals])
        charge = self._charge[of]
        return goes * area / charge, alone * area / charge, (goes + alone) / charge / solids[of]

    def trend(self, course: Course, step: float) -> np.ndarray:
        """Mean current of each metal in the coming step over that at its beginning.

        The total current goes on to change as in the step before, which makes the charge second
        order in time; a change above _JUMP, that before or the one to come, is an event and no
        trend.
        """
        out = np.ones(len(self.scene.metals))
        for n in range(len(out)):
            now, before = (s.numbers[f"current{n}"] for s in (course.state, course.previous))
            change = now - before
            further = step / course.previous_step if course.previous_step else 0.0
            if 0 < abs(change) * max(1.0, further) <= _JUMP * abs(now):
                out[n] += 0.5 * further * change / now
        return out

    def change_bound(self, fields: Fields) -> float:
        """Bound of the change of the currents since they were found, over their sum, first order.

        A surface that has receded by d since adds d / kappa in series with its patch, which moves
        no potential by more than the largest i d / kappa (the rows have no positive entries beside
        their diagonal, and no current falls with its potential), so no E by more than twice that.
        """
        problem = self._known_problem()
        grown = self.recession(problem, fields["concentration"]) - fields["receded"]
        density, area = fields["density"], problem.patches.area
        carried = float((area * np.abs(density)).sum())
        if not carried > 0:
            return 0.0
        lowest = float(np.min(self.scene.conductivity))
        moved = 2.0 * float((np.abs(density) * grown).max()) / lowest
        slope = np.zeros(len(area))
        for number, metal in enumerate(self.scene.metals):
            of = problem.patches.electrode == number
            slope[of] = metal.law.slope(fields["surface"][of])
        return moved * float((area * slope).sum()) / carried

    def moved(
        self, state: State, step: float, time: float, trend: np.ndarray, change: float = 0.0
    ) -> tuple[State, int]:
        """The state after a step with the currents of its beginning times `trend` of the metals.

        change : bound of the currents' change up to which the potential is not renewed, while no
        node goes.  Returns the linear iterations, too.
        """
        coupled, alone, _ = self.rates(state)
        concentration = state.fields["concentration"]
        numbers, moved, given = dict(state.numbers), concentration, None
        if (coupled + alone).any():
            problem = self.potential_problem(state.fields)
            assert problem is not None
            of = problem.patches.electrode
            coupled = step * coupled * trend[of]
            wanted = coupled + step * alone
            moved, delivered = self._drawn(problem, concentration, wanted)
            numbers["moles"] += float(delivered.sum())
            charge = np.where(self._dissolves, self._charge, 0.0)[of]
            part = coupled / np.where(wanted > 0, wanted, 1.0)  # of what was delivered
            numbers["charge"] += float((delivered * part * charge).sum())
            given = problem.patches.shares.T @ delivered
        gone = self.metal(concentration) & ~self.metal(moved)
        numbers["dissolved"] = float(gone.sum())
        fields = {**state.fields, "concentration": moved}
        if self.transport is not None:
            fields["ions"], left = self.transport.step(
                state.fields["ions"], given, ~self.metal(moved), step
            )
            numbers["released"] += left
        if gone.any():
            fields["lead"] = self.still_led(state.fields["lead"] & ~gone)
        new = State(time, fields, numbers)
        if change and not gone.any() and not self._ended(fields):
            if self.change_bound(fields) <= change:
                return State(time, fields, {**numbers, "newton": 0.0}), 0
        return self._with_potential(new)

    def conductivity_change(self, course: Course) -> float:
        """Largest relative change of the liquid's conductivity in the last step; 0 before one."""
        ions = self.scene.ions
        if ions is None or not course.previous_step:
            return 0.0
        wet = ~self.metal(course.previous.fields["concentration"])
        now, before = (
            ions.conducts(s.fields["ions"][wet]) for s in (course.state, course.previous)
        )
        return float(np.abs(now / before - 1.0).max(initial=0.0))

    def first_conductivity_change(self, state: State, step: float) -> float:
        """The same of a step to come, with all that patches give left where it enters."""
        ions, problem = self.scene.ions, self.potential_problem(state.fields)
        if ions is None or self.transport is None or problem is None:
            return 0.0
        coupled, alone, _ = self.rates(state)
        given = (
            problem.patches.shares.T @ (step * (coupled + alone)) / self.scene.lattice.cell_volume
        )
        content = state.fields["ions"]
        bonds = self.transport.sum
        there = bonds.crop(given.reshape(bonds.padded_shape)) + content
        wet = ~self.metal(state.fields["concentration"])
        # Without a limit of what dissolves, a law's points may end before all that is given.
        most = float(getattr(ions.conductivity, "concentrations", (np.inf,))[-1])
        later = ions.conducts(np.minimum(there, most)[wet])
        return float(np.abs(later / ions.conducts(content[wet]) - 1.0).max(initial=0.0))

    def _known_problem(self) -> PotentialProblem:
        """The potential problem of the metal that was looked at last."""
        problem = self._problem[1]
        assert problem is not None
        return problem

    @staticmethod
    def _bodies(problem: PotentialProblem) -> tuple[np.ndarray, np.ndarray]:
        """Patches of one metal node each: the first of every node, and (n,) which node's it is."""
        nodes = problem.patches.node
        _, first, body = np.unique(nodes, axis=0, return_index=True, return_inverse=True)
        return first, body.ravel()

    def _drawn(
        self, problem: PotentialProblem, concentration: np.ndarray, amount: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Concentrations after the patches drew amounts (mol), and what of these they got."""
        volume, patches = self.scene.lattice.cell_volume, problem.patches
        first, body = self._bodies(problem)
        wanted = np.bincount(body, amount)
        left, short = drain(concentration.ravel(), patches.drawn[first], wanted / volume)
        unmet = (short / np.where(wanted > 0, wanted, 1.0))[body] * amount
        if (unmet > 0).any():
            nodes = np.ravel_multi_index(tuple(patches.node.T), concentration.shape)
            for number, electrode in enumerate(problem.electrodes):
                of = (patches.electrode == number) & (unmet > 0)
                if of.any():
                    unmet[of] = spill(
                        left, self._place, self._place[nodes[of]], unmet[of],
                        np.flatnonzero(electrode.metal),
                    )  # fmt: skip
        return left.reshape(concentration.shape), amount - volume * unmet

    # --- what is written ------------------------------------------------------------------

    def row(self, state: State) -> tuple[float, ...]:
        """Charge, metal, what Faraday's law leaves open, and the currents."""
        numbers = state.numbers
        amount = float(state.fields["concentration"].sum()) * self.scene.lattice.cell_volume
        whole = max(numbers["initial"], 1e-300)
        return (
            numbers["charge"],
            amount,
            (numbers["initial"] - amount - numbers["moles"]) / whole,
            numbers["imbalance"],
            numbers["dissolved"],
            numbers["newton"],
            *(numbers[f"current{n}"] for n in range(len(self.scene.metals))),
            *self._of_ions(state, amount, whole),
        )

    def _of_ions(self, state: State, amount: float, whole: float) -> tuple[float, ...]:
        """Ions' columns, where they are followed: amounts, balance, most dissolved, salt, kappa."""
        ions = self.scene.ions
        if ions is None:
            return ()
        content, numbers = state.fields["ions"], state.numbers
        wet = ~self.metal(state.fields["concentration"])
        volume, dissolved = self.scene.lattice.cell_volume, ions.dissolved(content)
        held = float(content.sum()) * volume
        return (
            held,
            numbers["released"],
            (amount + held + numbers["released"] - numbers["initial"]) / whole,
            float(dissolved.max()),
            float((content - dissolved)[wet].sum()) * volume,
            float(ions.conducts(content[wet]).max()),
        )

    def snapshot(self, state: State) -> dict[str, np.ndarray | float]:
        """Concentration, metal, potential, current density and electrode potential on the lattice.

        The last two belong to the metal nodes at the surface; NaN elsewhere.
        """
        concentration = state.fields["concentration"]
        density, surface = np.full((2, *concentration.shape), np.nan)
        problem = self.potential_problem(state.fields)
        if problem is not None:
            nodes = tuple(problem.patches.node.T)
            density[nodes], surface[nodes] = state.fields["density"], state.fields["surface"]
        return {
            "concentration": concentration.copy(),
            "metal": self.metal(concentration),
            "potential": state.fields["potential"].copy(),
            "current_density": density,
            "electrode_potential": surface,
            **self._liquid(state),
        }

    def _liquid(self, state: State) -> dict[str, np.ndarray | float]:
        """Dissolved ions, salt and conductivity of the liquid, where they are followed."""
        ions = self.scene.ions
        if ions is None:
            return {}
        content = state.fields["ions"]
        wet, dissolved = ~self.metal(state.fields["concentration"]), ions.dissolved(content)
        salt = content - dissolved
        kappa = np.where(wet, ions.conducts(content), np.nan)
        return {"ions": dissolved, "salt": salt, "conductivity": kappa}

    def describe(self, state: State) -> str:
        """Time, and the largest current."""
        largest = max(abs(state.numbers[f"current{n}"]) for n in range(len(self.scene.metals)))
        return f"{moment(state.time)}, {largest:.4g} A"
