"""One march for every physics: decay in rate classes, a wave, a relaxed bar, own stepping."""

from dataclasses import dataclass

import numpy as np
import pytest

from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice
from peri.engine.march.checkpoints import CheckpointError, fingerprint
from peri.engine.march.marching import TimeStepping, march
from peri.engine.march.motion import Relaxation, VelocityVerlet
from peri.engine.march.problem import FirstOrder, Problem, SecondOrder, Stage, State
from peri.engine.march.stepping import time_after
from peri.engine.operators import NonlocalSum
from peri.engine.solvers import ConvergenceError


class Decay(FirstOrder):
    """y' = -k y in five cells with three rate classes each; what is lost is counted."""

    columns = {"left": "mol", "released": "mol"}
    evolved = ("content",)

    def __init__(self):
        self.rates = np.outer(np.linspace(0.5, 1.5, 5), [1.0, 3.0, 9.0])

    def key(self):
        return fingerprint("decay", self.rates)

    def initial(self):
        return State(0.0, {"content": np.ones((5, 3))}, {"released": 0.0})

    def stage(self, old, tau, guess):
        return self._stage(old["content"] / (1.0 + tau * self.rates))

    def explicit(self, old, step):
        content = old.fields["content"]
        lost = float((self.rates * content).sum())
        return Stage({"content": content * (1.0 - step * self.rates)}, {}, {"released": lost})

    def _stage(self, content):
        return Stage({"content": content}, {}, {"released": float((self.rates * content).sum())}, 1)

    def limits(self, state):
        return 2.0 / self.rates.max(), self.rates.max()

    def pace(self, state):
        return float(self.rates.max())

    def row(self, state):
        return float(state.fields["content"].sum()), state.numbers["released"]


@pytest.mark.parametrize("scheme, order", [("backward_euler", 1), ("sdirk2", 2)])
def test_decay_in_rate_classes_has_the_order_of_the_scheme(scheme, order):
    exact, errors = np.exp(-Decay().rates), []
    for steps in (40, 80, 160):
        done = march(Decay(), [1.0], TimeStepping(scheme, step=1.0 / steps))
        errors.append(np.abs(done.outputs[0]["content"] - exact).max())
        balance = done.history["left"] + done.history["released"]
        np.testing.assert_allclose(balance, 15.0, rtol=1e-13)  # round-off
    # measured 0.996, 0.998 and 2.005, 2.002
    assert np.all(np.abs(-np.diff(np.log2(errors)) - order) < 0.03)
    assert errors[-1] < {1: 2e-3, 2: 3e-6}[order]  # measured 1.7e-3, 2.1e-6


@pytest.mark.parametrize("stepping", [TimeStepping(), TimeStepping("forward_euler")])
def test_steps_that_follow_the_rates(stepping):
    done = march(Decay(), [0.0, 0.1, 2.0], stepping)
    exact = np.exp(-np.multiply.outer([0.0, 0.1, 2.0], Decay().rates))
    content = np.array([output["content"] for output in done.outputs])
    assert np.abs(content - exact).max() < 1.2e-2  # measured 1.6e-3 (sdirk2), 8.9e-3
    assert 10 < done.history["time"].size < 800
    assert done.history["time"][-1] == 2.0


class Wave(SecondOrder):
    """u'' = c^2 sum_j w_ij (u_j - u_i) on a row of nodes with free ends, c = 1."""

    motions = {"displacement": "velocity"}
    columns = {"energy": "J"}

    def __init__(self, nodes=400, ratio=3, wave_number=11.0):
        self.lattice = Lattice((0.0,), (1.0 / nodes,), (nodes,))
        self.stencil = diffusion_stencil(self.lattice, ratio / nodes)
        self.sum = NonlocalSum(self.stencil, self.lattice.shape)
        self.bonds = self.sum(self.sum.pad(np.ones(nodes)))
        self.wave_number = wave_number

    def key(self):
        return fingerprint("wave", self.lattice, self.wave_number)

    def initial(self):
        x = self.lattice.axis(0)
        fields = {"displacement": self.sum.pad(np.cos(self.wave_number * x))}
        return State(0.0, {**fields, "velocity": np.zeros(self.sum.padded_shape)})

    def acceleration(self, state):
        u = state.fields["displacement"]
        return {"displacement": self.sum(u) - self.bonds * u}

    def limit(self, state):
        return 2.0 / np.sqrt(2.0 * self.bonds.max())

    def row(self, state):
        u, v = state.fields["displacement"], state.fields["velocity"]
        return (0.5 * float((v * v).sum() - (u * self.acceleration(state)["displacement"]).sum()),)


def test_a_wave_moves_by_the_exact_dispersion_of_lattice_and_step():
    """omega^2 = sum w (1 - cos k xi), and sin(omega' dt / 2) = omega dt / 2 for Verlet."""
    wave, steps = Wave(), 40
    reach, h = wave.sum.reach[2], wave.lattice.spacing[0]
    xi = h * np.arange(reach + 1)
    omega = np.sqrt(2 * (wave.sum.octant.ravel() * (1 - np.cos(wave.wave_number * xi))).sum())
    step = 0.7 * wave.limit(wave.initial())
    done = march(wave, [steps * step], VelocityVerlet(step=step))
    found = wave.sum.crop(done.outputs[0]["displacement"])
    turned = 2.0 * np.arcsin(0.5 * omega * step) * steps
    exact = np.cos(wave.wave_number * wave.lattice.axis(0)) * np.cos(turned)
    inner = slice(steps * reach, -steps * reach)  # what the free ends cannot have reached
    assert 0.5 < turned < 1.5 and exact[inner].size > 100
    np.testing.assert_allclose(found[inner], exact[inner], atol=1e-12)  # measured 3.4e-14
    assert omega == pytest.approx(wave.wave_number, rel=1e-3)  # the local limit


def test_a_wave_keeps_its_energy_and_refuses_long_steps():
    done = march(Wave(), [3.0], VelocityVerlet())
    energy = done.history["energy"]
    assert np.ptp(energy) < 2e-3 * energy[0]  # measured 8e-4; bounded, it does not drift
    with pytest.raises(ValueError, match="exceeds the stability limit"):
        march(Wave(), [1.0], VelocityVerlet(step=1.0))


class Bar(SecondOrder):
    """A chain of springs held at one end and pulled at the other with a force t; some may break."""

    motions = {"displacement": "velocity"}
    columns = {"end": "m", "broken": "1"}

    def __init__(self, nodes=30, strength=np.inf):
        self.nodes, self.strength = nodes, strength
        self.stiffness = np.linspace(1.0, 2.0, nodes)  # one spring to the left of each node
        self.intact = np.ones(nodes)
        self.helper = 0.05  # a second, weak chain in parallel, which does not break

    def key(self):
        return fingerprint("bar", self.stiffness, self.strength)

    def initial(self):
        fields = {"displacement": np.zeros(self.nodes), "velocity": np.zeros(self.nodes)}
        return State(0.0, {**fields, "intact": np.ones(self.nodes)})

    def restore(self, state):
        self.intact = state.fields["intact"]

    def _stretch(self, u):
        return np.diff(u, prepend=0.0)

    def acceleration(self, state):
        k = self.stiffness * (self.intact + self.helper)
        force = k * self._stretch(state.fields["displacement"])
        a = np.append(force[1:], state.time) - force
        return {"displacement": a}

    def limit(self, state):
        return 2.0 / np.sqrt(4.0 * 2.0 * (1.0 + self.helper))

    def accept(self, state, stages, step):
        held = self._stretch(state.fields["displacement"]) * self.stiffness < self.strength
        self.intact = state.fields["intact"] = state.fields["intact"] * held

    def row(self, state):
        return state.fields["displacement"][-1], self.nodes - self.intact.sum()


def test_a_bar_relaxes_to_its_static_state():
    bar = Bar()
    done = march(bar, [0.5, 1.0], Relaxation(0.25, tolerance=1e-9))
    exact = np.cumsum(1.0 / (bar.stiffness * 1.05))
    for load, output in zip(done.times, done.outputs, strict=True):
        # measured 8.6e-10 of the end's displacement
        np.testing.assert_allclose(output["displacement"], load * exact, atol=1e-8 * exact[-1])
    assert done.history["time"].size == 5
    # measured 634; critical damping of the slowest mode (0.04 a step) alone would take 520
    assert 300 < done.history["iterations"][1:].max() < 1000


def test_a_bond_that_breaks_hands_its_load_on():
    done = march(Bar(strength=0.6), [0.5, 1.0], Relaxation(0.25, tolerance=1e-8))
    assert done.history["broken"].tolist() == [0.0, 0.0, 0.0, 30.0, 30.0]
    alone = np.cumsum(1.0 / (Bar().stiffness * 0.05))
    np.testing.assert_allclose(done.outputs[1]["displacement"], alone, rtol=1e-6)  # 4e-8


def test_relaxation_says_when_it_does_not_settle():
    with pytest.raises(ConvergenceError, match="relaxation: residual .* 1e-09 wanted"):
        march(Bar(), [1.0], Relaxation(1.0, tolerance=1e-9, maximum_iterations=10))


class Falling(Problem):
    """Nothing but a stepping of its own: y' = -y, solved exactly over steps that it chooses."""

    def key(self):
        return fingerprint("falling")

    def initial(self):
        return State(0.0, {"y": np.ones(1)}, {"steps": 0.0})


@dataclass(frozen=True)
class Exponential:
    """Steps that double."""

    first: float = 0.01

    def choose_first_step(self, problem, state, end):
        return self.first

    def advance(self, problem, course, target):
        old, step = course.state, min(course.step, target - course.state.time)
        numbers = {"steps": old.numbers["steps"] + 1}
        fields = {"y": old.fields["y"] * np.exp(-step)}
        course.step = 2.0 * course.step
        course.move(State(time_after(old.time, step, target), fields, numbers), step, 0)


def test_a_physics_may_bring_its_own_stepping():
    done = march(Falling(), [0.5, 3.0], Exponential())
    np.testing.assert_allclose([o["y"][0] for o in done.outputs], np.exp([-0.5, -3.0]), rtol=1e-13)
    assert done.state.numbers["steps"] == done.history["time"].size - 1 < 20


RESUMED = {
    "decay": (Decay, TimeStepping()),
    "decay, explicit": (Decay, TimeStepping("forward_euler", step=0.05)),
    "wave": (lambda: Wave(60), VelocityVerlet(step=0.01)),
    "bar": (lambda: Bar(strength=0.6), Relaxation(0.1, tolerance=1e-8)),
    "own": (Falling, Exponential()),
}


@pytest.mark.parametrize("name", RESUMED)
def test_a_resumed_march_is_the_same_to_the_last_bit(name, tmp_path):
    make, stepping = RESUMED[name]
    times = [0.0, 0.2, 1.0]
    whole = march(make(), times, stepping)
    path, calls = tmp_path / "march.h5", []

    def stop_half_way(fraction, text):
        calls.append(text)
        if fraction > 0.4:
            raise KeyboardInterrupt

    options = {"checkpoint": path, "checkpoint_every": 0.0}
    with pytest.raises(KeyboardInterrupt):
        march(make(), times, stepping, progress=stop_half_way, **options)
    before = len(calls)
    done = march(
        make(), times, stepping, resume=True, progress=lambda f, t: calls.append(t), **options
    )
    assert 2 < before and len(calls) - before < whole.history["time"].size  # it did go on
    for name, values in whole.history.items():
        np.testing.assert_array_equal(done.history[name], values)
    for one, other in zip(whole.outputs, done.outputs, strict=True):
        assert one.keys() == other.keys()
        for name, values in one.items():
            np.testing.assert_array_equal(other[name], values)
    with pytest.raises(CheckpointError, match="belongs to another"):
        march(make(), [0.0, 3.0], stepping, resume=True, **options)


class _Law:
    """A plain class without anything that tells two of them apart."""


class _KeyedLaw(_Law):
    def key(self):
        return ("keyed", 3.0)


def test_fingerprints_never_depend_on_an_address():
    assert fingerprint(_KeyedLaw()) == fingerprint(_KeyedLaw())
    with pytest.raises(TypeError, match="_Law: nothing tells two of them apart"):
        fingerprint({"law": _Law()})
    parts = [(1.0, 2.0), ((1.0,), 2.0), ("1.0", 2.0), (np.float64(1.0), np.array([2.0])), ()]
    assert len({fingerprint(*p) for p in parts}) == len(parts)
