"""Laws that give every metal node its own rate: by potential, liquid and age."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from peri.corrosion.kinetics import ConstantRate, Kinetics
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.nodes.problem import CorrosionProblem
from peri.corrosion.run import corrode
from peri.engine.march.marching import TimeStepping, march
from peri.engine.march.problem import State
from peri.omissions.planning import LIQUID, plan_omissions
from peri.omissions.well_stirred import well_stirred
from tests.peri.corrosion.nodes.test_bimaterial import right_side
from tests.peri.corrosion.scenes import WEEK, pin
from tests.peri.corrosion.test_run import check_invariants
from tests.peri.dense import pair_matrix

DAY = 86400.0
LAWS = ("proportional", "faradaic")


@dataclass(frozen=True)
class ByPotential(Kinetics):
    """A tenfold rate per volt."""

    needs = frozenset({"potential"})

    def rate(self, at):
        return 10.0**at.potential


@dataclass(frozen=True)
class Inhibited(Kinetics):
    """1 / (1 + C / half): solute in the liquid slows what sees it."""

    half: float
    needs = frozenset({"concentration"})

    def rate(self, at):
        return 1.0 / (1.0 + at.concentration / self.half)


@dataclass(frozen=True)
class Passivating(Kinetics):
    """exp(-age / time): what has been exposed for long is passive."""

    time: float
    needs = frozenset({"age"})

    def rate(self, at):
        return np.exp(-at.age / self.time)


@dataclass(frozen=True)
class Everywhere(Kinetics):
    """One number, said node by node."""

    number: float = 1.0
    needs = frozenset({"volume_loss", "age"})

    def rate(self, at):
        return self.number * 10.0 ** (-at.volume_loss / 0.1) * np.ones_like(at.age)


@dataclass(frozen=True)
class Once(Kinetics):
    """The same number for the whole metal."""

    slows = True

    def rate(self, at):
        return 10.0 ** (-at.volume_loss / 0.1)


@pytest.mark.parametrize("saturation", ["complementarity", "none"])
@pytest.mark.parametrize(
    ("dissolution", "scheme"),
    [(law, scheme) for law in LAWS for scheme in ("sdirk2", "backward_euler")]
    + [("proportional", "forward_euler")],
)
def test_one_number_said_node_by_node_is_that_number(dissolution, saturation, scheme):
    scene = pin(2, 14, dissolution=dissolution, saturation=saturation, liquid_diffusivity=1e-11,
                saturation_concentration=66.0, kinetics=Once())  # fmt: skip
    end = WEEK if scheme != "forward_euler" else 100.0 / BiMaterial(scene).fastest_rate()
    stepping = TimeStepping(scheme, step=None if scheme == "forward_euler" else WEEK / 5)
    once = corrode(scene, [end], stepping)
    everywhere = corrode(replace(scene, kinetics=Everywhere()), [end], stepping)
    assert once.volume_loss[0] > 1e-3
    # round-off of another order of sums and the stage's 1e-9
    assert everywhere.volume_loss[0] == pytest.approx(once.volume_loss[0], rel=1e-9)
    difference = np.abs(everywhere.concentration - once.concentration).max()
    assert difference < 1e-8 * scene.solid_concentration


def test_a_stage_is_the_dense_solution_with_a_rate_of_every_nodes_own():
    scene = pin(2, 14, saturation="none", interface_diffusivity=1e-15, kinetics=ByPotential())
    problem = BiMaterial(scene, 1e-13)
    x, y = scene.lattice.coordinates()
    own = 1.0 + 2.0 * np.sin(4e3 * x) * np.cos(3e3 * y)
    problem.surface["potential"] = problem.take(problem.sum.pad(own))
    old, tau = problem.initial_concentration, 0.3 * WEEK
    found = problem.sum.crop(problem.implicit_stage(old, tau, old, None, 0.0).concentration)
    one = np.ones(scene.lattice.shape)
    operator = right_side(problem, replace(scene, kinetics=ConstantRate()), one, 0.0)
    metal = scene.metal.ravel()
    across = pair_matrix(scene.stencil, scene.lattice.shape) * scene.capacity().ravel()[None, :]
    across = 1e-15 * across * np.outer((10.0**own).ravel() - 1.0, ~metal) * metal[:, None]
    across = across + across.T  # cells count fully here
    across[scene.refreshed().ravel()] = 0.0
    operator = operator + across - np.diag(across.sum(axis=1))
    expected = np.linalg.solve(
        np.eye(metal.size) - tau * operator, problem.sum.crop(old).ravel()
    ).reshape(found.shape)
    # measured 5e-13 of C_solid
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * scene.solid_concentration)
    lost = (scene.solid_concentration - found)[scene.metal]
    assert lost.max() > 3 * np.median(lost[lost > 0])


@pytest.mark.parametrize("dissolution", LAWS)
def test_a_rate_that_looks_at_the_liquid_agrees_with_what_it_sees(dissolution):
    """Closed liquid fills up and slows the metal; the stage's rate belongs to its own liquid."""
    law = Inhibited(20.0)
    scene = pin(2, 14, boundary="no_flux", dissolution=dissolution, saturation="none",
                interface_diffusivity=1e-14, kinetics=law)  # fmt: skip
    problem = BiMaterial(scene, 1e-12)
    old, tau = problem.initial_concentration, 0.1 * WEEK
    stage = problem.implicit_stage(old, tau, old, None, 0.0)
    liquid = problem.take(np.where(problem.metal, 0.0, stage.concentration))
    _, share = problem.interface_rate(0.0, problem.seen_liquid(liquid))
    bonds = 1e-14 * share * problem.box(problem.box_liquid_volume)
    new = problem.take(stage.concentration)
    drive = scene.solid_concentration if dissolution == "faradaic" else new
    seen = problem.box(problem.box_liquid_volume * np.where(problem.box_metal, 0.0, new))
    flux = bonds * drive - (0.0 if dissolution == "faradaic" else 1e-14 * share * seen)
    expected = problem.take(old) - tau * flux
    metal = problem.box_metal
    # the stage knows its rates to 1e-7: measured 1.2e-9, 1.3e-9 of C_solid
    assert np.abs(new - expected)[metal].max() < 1e-7 * scene.solid_concentration
    assert share[metal & (seen > 0)].max() < 0.9
    plain = corrode(replace(scene, kinetics=ConstantRate()), [2 * WEEK])
    slowed = corrode(scene, [2 * WEEK])
    check_invariants(scene, slowed)
    assert 0.01 < slowed.volume_loss[0] < 0.8 * plain.volume_loss[0]


@pytest.mark.parametrize("dissolution", LAWS)
def test_age_passivates_what_was_exposed_and_not_what_is_new(dissolution, tmp_path):
    rate = {"proportional": 1e-13, "faradaic": 3.2e-14}[dissolution]
    scene = pin(2, 14, dissolution=dissolution, interface_diffusivity=rate,
                liquid_diffusivity=1e-8, kinetics=Passivating(2 * DAY))  # fmt: skip
    times = [2 * DAY, 4 * WEEK]
    result = corrode(scene, times)
    check_invariants(scene, result)
    rate = np.diff(result.history["volume_loss"]) / result.history["step"][1:]
    assert result.history["dissolved_nodes"].sum() > 0
    assert rate[-1] < 1e-2 * rate[0]
    never = corrode(replace(scene, kinetics=ConstantRate()), times)
    # measured 0.70 and 0.60, eight nodes of 32 dissolved; without passivation nothing is left
    assert 0.5 < result.volume_loss[-1] < 0.75 < never.volume_loss[-1]
    # what was dissolved exposed new nodes, whose age began later
    problem = CorrosionProblem(scene)
    state = march(problem, times, TimeStepping()).state
    exposed = state.fields["exposed"]
    assert np.unique(exposed[np.isfinite(exposed)]).size == 2
    # resumed, it is the same march
    path = tmp_path / "march.h5"

    def stop(fraction, text):
        if fraction > 0.1:
            raise KeyboardInterrupt

    options = {"checkpoint": path, "checkpoint_every": 0.0}
    with pytest.raises(KeyboardInterrupt):
        corrode(scene, times, progress=stop, **options)
    resumed = corrode(scene, times, resume=True, **options)
    np.testing.assert_array_equal(resumed.concentration, result.concentration)


def test_a_coupled_problem_gives_what_the_law_needs():
    scene = pin(2, 14, kinetics=ByPotential())
    with pytest.raises(ValueError, match="it needs potential, which a march of corr"):
        corrode(scene, [WEEK])

    class Polarised(CorrosionProblem):
        """Corrosion at a potential that rises by a volt in a week."""

        def begin(self, state: State) -> None:
            super().begin(state)
            self.discrete.surface["potential"] = state.time / WEEK

    problem = Polarised(scene, given=["potential"])
    done = march(problem, [WEEK], TimeStepping("backward_euler", step=WEEK / 50))
    plain = corrode(replace(scene, kinetics=ConstantRate()), [WEEK])
    # int 10^(t / week) dt / week = 9 / ln 10 = 3.909, in fifty steps and some saturation less
    ratio = done.outputs[0]["volume_loss"] / plain.volume_loss[0]
    assert 3.2 < ratio < 3.9


def test_what_rests_on_one_rate_goes_by_needs():
    scene = pin(2, 14, saturation_concentration=6.6, kinetics=Once())
    local = replace(scene, kinetics=Everywhere())
    assert Once().never_speeds_up and Once().is_global
    assert not Everywhere().is_global and not Everywhere().never_speeds_up
    applied = {o.name: o.applied for o in plan_omissions(local, WEEK)}
    assert not applied[LIQUID]
    with pytest.raises(ValueError, match="Everywhere needs age, volume_loss; clean liquid"):
        well_stirred(local, [WEEK])


def test_refusals():
    class Wishful(Kinetics):
        needs = frozenset({"weather"})

        def rate(self, at):
            return 1.0

    class Empty(Kinetics):
        """A law without a rate."""

    with pytest.raises(
        ValueError, match="kinetics: it needs weather; known: volume_loss, phase, c"
    ):
        pin(2, kinetics=Wishful())
    with pytest.raises(ValueError, match="it must be a corrosion.kinetics.Kinetics"):
        pin(2, kinetics="constant")
    with pytest.raises(TypeError, match="abstract class Empty .*rate"):
        Empty()
    assert Inhibited(2.0).key() == {"law": "Inhibited", "half": 2.0}
