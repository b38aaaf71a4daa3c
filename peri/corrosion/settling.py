"""The volume loss that agrees with the rate it causes."""

from __future__ import annotations

from collections.abc import Callable

_NARROW = 1e-13
"""A bracket of the volume loss that rounding alone fills."""


def settled_loss(
    loss_at: Callable[[float], float], start: float, tolerance: float, trials: int
) -> float:
    """V_L in [0, 1] with loss_at(V_L) = V_L, by a secant kept inside its bracket.

    loss_at : what is lost at the rate of a volume loss; falls as the volume loss grows, so that
    there is one solution.  (The plain fixed point jumps between two wrong values where a step
    dissolves more than about l.)  start : where to begin.  tolerance : of loss_at(V_L) - V_L.
    trials : after so many the last V_L is returned as it is.
    """
    loss, low, high = start, 0.0, 1.0
    last: tuple[float, float] | None = None
    for _ in range(trials):
        found = loss_at(loss)
        excess = found - loss
        if abs(excess) <= tolerance or high - low <= _NARROW:
            break
        low, high = (loss, high) if excess > 0 else (low, loss)
        trial = found
        if last is not None and excess != last[1]:
            trial = loss - excess * (loss - last[0]) / (excess - last[1])
        last = loss, excess
        loss = trial if low < trial < high else 0.5 * (low + high)
    return loss
