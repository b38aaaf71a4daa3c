"""The composition of a node from its totals: a convex minimisation, compiled.

With C_k(m) = exp(b_k + sum_e nu_ke m_e), the m that satisfies sum_k nu_ke w_k C_k = S_e for every
component e is the minimum of

    F(m) = sum_k w_k C_k(m) - sum_e S_e m_e,        Hessian nu^T diag(w C) nu.

w = 1 gives the composition of a vessel with totals S_e = T_e, w_k = D_k that of a node of which
transport knows Pi_e = sum_k nu_ke D_k C_k.  F is strictly convex, so the minimum is unique and
Newton's method with steps of bounded length and a search along them finds it.  Eight nodes are
done at a time, so that the processor works on vectors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import get_num_threads, njit

ABSENT = -1.0e4
"""m of a component that a node does not hold: its species have exp(-1e4) = 0 exactly."""

TOLERANCE = 3e-8
"""Newton step after which there is no other: the next would be about its square."""

_LANES = 8
_LONGEST_STEP = 2.0
_MAXIMUM_STEPS = 400
_THREADED_FROM = 4096
"""Nodes per thread below which threads cost more than they save."""
_BLOCK = 65536
"""Nodes, a multiple of the lanes, that are copied and composed at a time: of a large lattice the
totals of all of them would be gigabytes."""


class CompositionError(ArithmeticError):
    """A node has no composition: a total is negative that only positive amounts can make up."""


@njit(cache=True, nogil=True, fastmath={"contract"})
def _compose(m, target, b, weight, row, component, nu, positive, tolerance, first, last, out):
    """Solve nodes first:last in place, C to `out` (K, n); returns how many nodes failed."""
    E, n = m.shape
    K = weight.size
    V = _LANES
    H = np.empty((E, E, V))
    r = np.empty((E, V))
    x = np.empty((E, V))
    old = np.empty((E, V))
    step = np.empty((E, V))
    weighted = np.empty((K, V))
    taken = np.empty((E, V))
    value, before, slope, size = np.empty(V), np.empty(V), np.empty(V), np.empty(V)
    scale = np.empty(V)
    done = np.empty(V, np.bool_)
    failed = 0
    shared = b.shape[1] == 1
    for start in range(first, last, V):
        width = min(V, last - start)
        for v in range(V):
            i = start + min(v, width - 1)
            done[v] = False
            before[v] = np.inf
            slope[v] = 0.0
            size[v] = 0.0
            for e in range(E):
                x[e, v] = m[e, i]
                step[e, v] = 0.0
                if positive[e] and target[e, i] <= 0.0:
                    x[e, v] = ABSENT
                    if target[e, i] < 0.0 or np.isnan(target[e, i]):
                        done[v] = True
                        failed += v < width
                elif x[e, v] < -690.0:
                    x[e, v] = math.log(target[e, i] / positive[e]) if positive[e] else -16.0
                old[e, v] = x[e, v]
        iteration = 0
        while iteration < _MAXIMUM_STEPS:
            iteration += 1
            for e in range(E):
                for v in range(V):
                    r[e, v] = target[e, start + min(v, width - 1)]
                for q in range(e + 1):
                    for v in range(V):
                        H[e, q, v] = 0.0
            for v in range(V):
                value[v] = 0.0
                size[v] = 0.0
            for k in range(K):
                s = weighted[k]
                for v in range(V):
                    s[v] = b[k, 0 if shared else start + min(v, width - 1)]
                for a in range(row[k], row[k + 1]):
                    for v in range(V):
                        s[v] += nu[a] * x[component[a], v]
                for v in range(V):
                    s[v] = weight[k] * math.exp(s[v])
                    value[v] += s[v]
                for a in range(row[k], row[k + 1]):
                    e = component[a]
                    for v in range(V):
                        r[e, v] -= nu[a] * s[v]
                    for c in range(row[k], a + 1):
                        for v in range(V):
                            H[e, component[c], v] += nu[a] * nu[c] * s[v]
            for e in range(E):
                for v in range(V):
                    if x[e, v] > ABSENT:
                        part = target[e, start + min(v, width - 1)] * x[e, v]
                        value[v] -= part
                        size[v] += abs(part)
                    else:
                        r[e, v] = 0.0
                        H[e, e, v] = 1.0
            # A step that does not descend (Armijo) is halved; the others go on.
            for v in range(V):
                noise = 1e-13 * (size[v] + abs(value[v]))
                if value[v] <= before[v] - 1e-4 * slope[v] + noise:
                    scale[v] = 0.0
                else:
                    scale[v] = 0.5
            for j in range(E):
                for v in range(V):
                    total = H[j, j, v]
                    for q in range(j):
                        total -= H[j, q, v] * H[j, q, v]
                    H[j, j, v] = 1.0 / math.sqrt(total)
                for p in range(j + 1, E):
                    for q in range(j):
                        for v in range(V):
                            H[p, j, v] -= H[p, q, v] * H[j, q, v]
                    for v in range(V):
                        H[p, j, v] *= H[j, j, v]
            for v in range(V):
                slope[v] *= 0.5
            for j in range(E):
                for q in range(j):
                    for v in range(V):
                        r[j, v] -= H[j, q, v] * r[q, v]
                for v in range(V):
                    r[j, v] *= H[j, j, v]
            for v in range(V):
                if scale[v] == 0.0:
                    slope[v] = 0.0
                    for e in range(E):
                        slope[v] += r[e, v] * r[e, v]
            for j in range(E - 1, -1, -1):
                for p in range(j + 1, E):
                    for v in range(V):
                        r[j, v] -= H[p, j, v] * r[p, v]
                for v in range(V):
                    r[j, v] *= H[j, j, v]
            pending = 0
            for v in range(V):
                if done[v]:
                    for e in range(E):
                        taken[e, v] = 0.0
                    continue
                if scale[v] == 0.5:
                    for e in range(E):
                        step[e, v] *= 0.5
                        x[e, v] = old[e, v] + step[e, v]
                    pending += 1
                    continue
                before[v] = value[v]
                longest = 0.0
                for e in range(E):
                    longest = max(longest, abs(r[e, v]))
                if not longest < np.inf:
                    done[v] = True
                    failed += v < width
                    continue
                factor = min(1.0, _LONGEST_STEP / longest) if longest > 0 else 1.0
                slope[v] *= factor
                for e in range(E):
                    old[e, v] = x[e, v]
                    step[e, v] = factor * r[e, v]
                    x[e, v] += step[e, v]
                    taken[e, v] = step[e, v]
                if longest < tolerance:
                    done[v] = True
                else:
                    pending += 1
            if pending == 0:
                break
        for v in range(width):
            if not done[v]:
                failed += 1
            for e in range(E):
                m[e, start + v] = x[e, v]
        # exp of the last step, which is short, by its series: exact to the last digit.
        for k in range(K):
            for v in range(width):
                moved = 0.0
                for a in range(row[k], row[k + 1]):
                    moved += nu[a] * taken[component[a], v]
                out[k, start + v] = weighted[k, v] / weight[k] * (1.0 + moved * (1.0 + 0.5 * moved))
    return failed


@njit(cache=True, nogil=True)
def _concentrations(m, b, row, component, nu, out):
    K, n = out.shape
    shared = b.shape[1] == 1
    for k in range(K):
        for i in range(n):
            s = b[k, 0 if shared else i]
            for a in range(row[k], row[k + 1]):
                s += nu[a] * m[component[a], i]
            out[k, i] = math.exp(s)


@njit(cache=True, nogil=True, error_model="numpy")
def _sensitivity(concentration, weight, row, component, nu, taken, out):
    """taken . H^-1 taken per node, H the Hessian of this file's head (1 for absent components)."""
    E = taken.size
    H = np.empty((E, E))
    y = np.empty(E)
    for i in range(out.size):
        H[:] = 0.0
        for k in range(weight.size):
            s = weight[k] * concentration[k, i]
            for a in range(row[k], row[k + 1]):
                for c in range(row[k], a + 1):
                    H[component[a], component[c]] += nu[a] * nu[c] * s
        for e in range(E):
            y[e] = 1.0 / math.sqrt(H[e, e]) if H[e, e] > 0.0 else 1.0
        for e in range(E):  # a unit diagonal first: the components differ by decades
            for q in range(e):
                H[e, q] *= y[e] * y[q]
            H[e, e] = 1.0
        y *= taken
        total = 0.0
        for j in range(E):
            for q in range(j):
                H[j, j] -= H[j, q] * H[j, q]
                y[j] -= H[j, q] * y[q]
            inverse = 1.0 / math.sqrt(H[j, j])
            y[j] *= inverse
            for p in range(j + 1, E):
                for q in range(j):
                    H[p, j] -= H[p, q] * H[j, q]
                H[p, j] *= inverse
            total += y[j] * y[j]
        out[i] = total


class Composer:
    """Finds compositions for one stoichiometry and one set of weights.

    Parameters
    ----------
    stoichiometry : (K, E)
    weight : (K,) w_k > 0, for instance D_k or 1
    """

    def __init__(self, stoichiometry: np.ndarray, weight: np.ndarray) -> None:
        self.stoichiometry = np.asarray(stoichiometry, float)
        self.weight = np.ascontiguousarray(weight, float)
        counts = (self.stoichiometry != 0).sum(axis=1)
        self._row = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self._component = np.nonzero(self.stoichiometry)[1].astype(np.int64)
        self._nu = self.stoichiometry[self.stoichiometry != 0]
        only_positive = (self.stoichiometry >= 0).all(axis=0)
        # Per component that only positive amounts make up: the weight of the component itself.
        components = self.stoichiometry.shape[1]
        self._positive = np.where(only_positive, self.weight[:components], 0.0)

    @property
    def only_positive(self) -> np.ndarray:
        """Components whose totals cannot be negative, (E,) bool."""
        return self._positive > 0

    def solve(
        self, target: np.ndarray, b: np.ndarray, m: np.ndarray, tolerance: float = TOLERANCE
    ) -> np.ndarray:
        """Improve m in place until the last Newton step is below `tolerance` at every node.

        Parameters
        ----------
        target : (E, n) S_e; zero for a component that the node does not hold
        b : (K, n) or (K, 1) conditional constants
        m : (E, n) starting values
        tolerance : the step after the one tested, which is not taken, is of the order tolerance^2

        Returns the concentrations, (K, n).  Raises CompositionError.
        """
        out = np.empty((self.weight.size, m.shape[1]))
        self.fill(lambda nodes: target[:, nodes], b, m, out, tolerance)
        return out

    def fill(
        self,
        target: Callable[[slice], np.ndarray],
        b: np.ndarray,
        m: np.ndarray,
        out: np.ndarray,
        tolerance: float = TOLERANCE,
    ) -> None:
        """As `solve`, the concentrations into `out` (K, n), block by block.

        target : gives S_e of a range of nodes, (E, nodes)
        """
        n, failed, lowest = m.shape[1], 0, np.inf
        for start in range(0, n, _BLOCK):
            nodes = slice(start, min(start + _BLOCK, n))
            x, wanted = np.ascontiguousarray(m[:, nodes]), np.ascontiguousarray(target(nodes))
            constants = b if b.shape[1] == 1 else np.ascontiguousarray(b[:, nodes])
            found = np.empty((len(out), x.shape[1]))
            some = self._compose_block(wanted, constants, x, found, tolerance)
            m[:, nodes], out[:, nodes] = x, found
            if some:
                positive = np.where(self.only_positive[:, None], wanted, np.inf)
                failed, lowest = failed + some, min(lowest, positive.min())
        if failed:
            raise CompositionError(
                f"composition: {failed} of {n} nodes have none; the lowest total of a component "
                f"that only positive amounts make up is {lowest:.3g}"
            )

    def _compose_block(
        self, target: np.ndarray, b: np.ndarray, m: np.ndarray, out: np.ndarray, tolerance: float
    ) -> int:
        n = m.shape[1]
        workers = max(1, min(get_num_threads(), n // _THREADED_FROM))
        edges = [_LANES * round(n * w / workers / _LANES) for w in range(workers)] + [n]

        def part(w: int) -> int:
            return _compose(
                m, target, b, self.weight, self._row, self._component, self._nu,
                self._positive, tolerance, edges[w], edges[w + 1], out,
            )  # fmt: skip

        if workers == 1:
            return part(0)
        with ThreadPoolExecutor(workers) as pool:
            return sum(pool.map(part, range(workers)))

    def concentrations(
        self, m: np.ndarray, b: np.ndarray, out: np.ndarray | None = None
    ) -> np.ndarray:
        """Return C, (K, n), for m (E, n)."""
        if out is None:
            out = np.empty((self.weight.size, m.shape[1]))
        _concentrations(m, b, self._row, self._component, self._nu, out)
        return out

    def sensitivity(self, concentration: np.ndarray, taken: np.ndarray) -> np.ndarray:
        """-d(taken . m) / dG per node, (n,), where G takes `taken` (E,) of the components: > 0."""
        out = np.empty(concentration.shape[1])
        _sensitivity(
            concentration, self.weight, self._row, self._component, self._nu,
            np.asarray(taken, float), out,
        )  # fmt: skip
        return out

    def hessian(self, concentration: np.ndarray) -> np.ndarray:
        """Return nu^T diag(w C) nu per node, (n, E, E); 1 on the diagonal of absent components."""
        weighted = (self.weight[:, None] * concentration).T
        h = np.einsum("nk,ke,kf->nef", weighted, self.stoichiometry, self.stoichiometry,
                      optimize=True)  # fmt: skip
        e = np.arange(h.shape[1])
        h[:, e, e] += h[:, e, e] == 0.0
        return h
