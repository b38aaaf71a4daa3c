"""Return mapping of the porous yield function in two scalars.

Yield (5.40), with q2 and q3 of Tvergaard for generality (published: q2 = 1, q3 = q1^2), written in
the Kirchhoff stress tau = J sigma by S = J s_y, which is the same function:

    Phi = (tau_eq / S)^2 + 2 q1 f* cosh(q2 tr tau / (2 S)) - (1 + q3 f*^2)

Associated flow. The unknowns are a, the plastic volume strain of the step, and beta, the factor
by which the trial deviator shrinks; all else follows from them:

    p = K (ev - a)     q = beta q_trial     de_q = (1 - beta) q_trial / (3 G)     h = 3 q2 p / (2 S)
    R1 = a beta - q1 q2 f* S / (2 G) (1 - beta) sinh h = 0                        (flow direction)
    R2 = (q/S)^2 + 4 q1 f* sinh^2(h/2) - (1 - 2 q1 f* + q3 f*^2) = 0              (yield)

f = 1 - (1 - f_n) exp(-a) integrates (5.42) exactly; strain-controlled nucleation (off by default)
adds f_N times the increment of a normal distribution in plastic strain. The plastic strain grows by
sqrt(2/3 d^p : d^p) = sqrt(de_q^2 + 2/9 a^2), as (5.39). J2 is f = 0 in the same equations.
f stays at most at `limit`, where the strength is RESIDUAL_STRENGTH of the intact one.

LAGGED keeps f as it is given in R1 and R2 where pores grow, and updates it afterwards: the step is
then that of a hardening metal without softening, whose equilibrium is unique and whose tangent is
nearly symmetric (Newton finds the coupled equations' solution hardly ever once many points soften
at the same time). With f of the start of the step the error is of first order, with f foreseen of
its end (`QuadratureState.foresee`) of second. Pores that close harden the metal, so there f is that
of the end of the step: with the old one R1 would close more than there is, and no step of Newton's
would end.
"""

from __future__ import annotations

from math import erf

import numpy as np

from fem.constitutive.compiled import kernel
from fem.constitutive.hardening import flow_stress

# indices of the parameter vector of the kernels
BULK, SHEAR, Q1, Q2, Q3, NUCLEATED, NUCLEATION_MEAN, NUCLEATION_DEVIATION = range(8)
COALESCENCE, ACCELERATION, LIMIT, LAGGED, STIFFNESS_LOSS, STIFFENING = range(8, 14)
PARAMETERS = 14
RESIDUAL_STRENGTH = 0.02
"""Share of the strength at which metal counts as gone.

The published limit is zero. Below, cells flow under next to no force and cost most of the Newton
iterations.
"""
_MAX_ARGUMENT = 200.0
_NEWTON_ITERATIONS = 25
_BISECTIONS = 200
_START_ITERATIONS = 6


@kernel
def effective_damage(damage: float, material: np.ndarray) -> tuple[float, float]:
    """Return f*(f) and its slope: f up to coalescence, faster after it."""
    onset = material[COALESCENCE]
    if damage <= onset:
        return damage, 1.0
    return onset + material[ACCELERATION] * (damage - onset), material[ACCELERATION]


@kernel
def yield_function(
    mises: float, pressure: float, flow: float, damage: float, material: np.ndarray
) -> float:
    """Phi of (5.40) for equivalent stress, mean stress, yield stress and f; no cancellation."""
    effective, _ = effective_damage(damage, material)
    half = 0.75 * material[Q2] * pressure / flow
    half = min(max(half, -0.5 * _MAX_ARGUMENT), 0.5 * _MAX_ARGUMENT)
    strength = 1.0 - 2.0 * material[Q1] * effective + material[Q3] * effective**2
    return (mises / flow) ** 2 + 4.0 * material[Q1] * effective * np.sinh(half) ** 2 - strength


@kernel
def _sinh(x):
    """Hyperbolic sine to round-off: a series near 0, where the stress state of a bar is."""
    if abs(x) < 0.5:
        square = x * x
        series = 1.0 / 39916800.0 + square * (1.0 / 6227020800.0)
        series = 1.0 / 5040.0 + square * (1.0 / 362880.0 + square * series)
        return x + x * square * (1.0 / 6.0 + square * (1.0 / 120.0 + square * series))
    grown = np.exp(abs(x))
    return np.copysign(0.5 * (grown - 1.0 / grown), x)


@kernel
def grown(damage: float, volume: float, before: float, after: float, material: np.ndarray) -> float:
    """f of (5.42) after a plastic volume strain, nucleation between two plastic strains included.

    Not yet held within 0 and f_max.
    """
    f = damage + (damage - 1.0) * np.expm1(-volume)
    if material[NUCLEATED] > 0.0:
        width = material[NUCLEATION_DEVIATION] * np.sqrt(2.0)
        old = (before - material[NUCLEATION_MEAN]) / width
        new = (after - material[NUCLEATION_MEAN]) / width
        f += 0.5 * material[NUCLEATED] * (erf(new) - erf(old))
    return f


@kernel
def _system(a, beta, volume, mises, jacobian, strain, damage, material, kind, hardening):
    """Residuals, their derivatives by (a, beta, volume, mises), new plastic strain and f."""
    q1, q2, q3 = material[Q1], material[Q2], material[Q3]
    keep = 1.0 - beta
    per_shear = 1.0 / (3.0 * material[SHEAR])
    per_mises = keep * per_shear  # plastic deviatoric strain over trial stress
    deviatoric = per_mises * mises
    step = np.sqrt(deviatoric * deviatoric + 2.0 / 9.0 * a * a)
    per_step = 1.0 / step if step > 0.0 else 0.0
    e_a, e_d = 2.0 / 9.0 * a * per_step, deviatoric * per_step
    e_b, e_q = -e_d * mises * per_shear, e_d * per_mises
    flow, slope = flow_stress(kind, hardening, strain + step)
    flow *= jacobian
    slope *= jacobian
    per_flow = 1.0 / flow
    # s_x: logarithmic derivatives of the flow stress S
    s_a, s_b, s_q = slope * per_flow * e_a, slope * per_flow * e_b, slope * per_flow * e_q

    f = grown(damage, a, strain, strain + step, material)
    f_a, f_b, f_q = (1.0 - damage) * np.exp(-a), 0.0, 0.0
    if material[NUCLEATED] > 0.0:
        width = material[NUCLEATION_DEVIATION] * np.sqrt(2.0)
        new = (strain + step - material[NUCLEATION_MEAN]) / width
        rate = material[NUCLEATED] * np.exp(-new * new) / (width * np.sqrt(np.pi))
        f_a, f_b, f_q = f_a + rate * e_a, rate * e_b, rate * e_q
    if f >= material[LIMIT]:
        f, f_a, f_b, f_q = material[LIMIT], 0.0, 0.0, 0.0
    elif f < 0.0:
        f, f_a, f_b, f_q = 0.0, 0.0, 0.0, 0.0
    if material[LAGGED] > 0.0 and a >= 0.0:
        g, g_f = effective_damage(damage, material)
        g_f = 0.0
    else:
        g, g_f = effective_damage(f, material)
    g_a, g_b, g_q = g_f * f_a, g_f * f_b, g_f * f_q

    per_volume = 1.5 * q2 * material[BULK] * per_flow
    h = per_volume * (volume - a)
    h = min(max(h, -_MAX_ARGUMENT), _MAX_ARGUMENT)
    h_a, h_b, h_q, h_v = -per_volume - h * s_a, -h * s_b, -h * s_q, per_volume - h
    half = _sinh(0.5 * h)
    sinh, cosh = 2.0 * half * np.sqrt(1.0 + half * half), 1.0 + 2.0 * half * half

    factor = 1.5 * q1 * q2 * flow * per_shear
    drive, open_g, open_h = factor * g * sinh, factor * sinh, factor * g * cosh
    r1 = a * beta - keep * drive
    r1_a = beta - keep * (open_g * g_a + drive * s_a + open_h * h_a)
    r1_b = a + drive - keep * (open_g * g_b + drive * s_b + open_h * h_b)
    r1_q = -keep * (open_g * g_q + drive * s_q + open_h * h_q)
    r1_v = -keep * (drive + open_h * h_v)

    ratio = beta * mises * per_flow
    square = 2.0 * ratio * ratio
    strength = 1.0 - 2.0 * q1 * g + q3 * g * g
    by_g = 4.0 * q1 * half * half + 2.0 * q1 - 2.0 * q3 * g
    by_h = 2.0 * q1 * g * sinh
    r2 = ratio * ratio + 4.0 * q1 * g * half * half - strength
    r2_a = by_g * g_a + by_h * h_a - square * s_a
    r2_b = by_g * g_b + by_h * h_b - square * s_b + 2.0 * ratio * mises * per_flow
    r2_q = by_g * g_q + by_h * h_q - square * s_q + 2.0 * ratio * beta * per_flow
    r2_v = by_h * h_v - square
    return (
        (r1, r1_a, r1_b, r1_v, r1_q),
        (r2, r2_a, r2_b, r2_v, r2_q),
        (strain + step, f, flow, abs(a * beta) + abs(keep * drive), strength),
    )


@kernel
def _bracketed(volume, mises, jacobian, strain, damage, material, kind, hardening):
    """Solve by nested bisection: beta from R2 at given a, a from R1. Never leaves the range.

    Without pores at the start a = 0 solves the equations for any pressure; a second root, where a
    finite step would open pores out of nothing, is an artefact of the implicit step and not sought.
    """
    if volume >= 0.0:
        near, far = 0.0, volume
    else:
        near, far = 0.0, max(volume, np.log1p(-damage))
    a, beta = 0.0, 1.0
    if damage == 0.0 and material[NUCLEATED] == 0.0:
        far = 0.0
    for _ in range(_BISECTIONS):
        a = 0.5 * (near + far)
        low, high = 0.0, 1.0
        _, at_low, _ = _system(
            a, low, volume, mises, jacobian, strain, damage, material, kind, hardening
        )
        _, at_high, _ = _system(
            a, high, volume, mises, jacobian, strain, damage, material, kind, hardening
        )
        if at_low[0] > 0.0:
            near, beta = a, 0.0
        elif at_high[0] < 0.0:
            far, beta = a, 1.0
        else:
            for _ in range(_BISECTIONS):
                beta = 0.5 * (low + high)
                _, value, _ = _system(
                    a, beta, volume, mises, jacobian, strain, damage, material, kind, hardening
                )
                if value[0] > 0.0:
                    high = beta
                else:
                    low = beta
                if high - low <= 1e-15 * high:
                    break
            flow, _, _ = _system(
                a, beta, volume, mises, jacobian, strain, damage, material, kind, hardening
            )
            if (flow[0] > 0.0) == (volume >= 0.0):
                far = a
            else:
                near = a
        if abs(far - near) <= 1e-15 * abs(far):
            break
    flow_now, _ = flow_stress(kind, hardening, strain)
    if a != 0.0 and (beta == 0.0 or beta == 1.0 or mises <= 1e-9 * jacobian * flow_now):
        # the yield surface alone fixes a (no trial deviator): the ratio follows from R1
        flow, _, _ = _system(
            a, 0.0, volume, mises, jacobian, strain, damage, material, kind, hardening
        )
        beta = -flow[0] / (a - flow[0])
    return a, beta


@kernel
def _start(volume, mises, jacobian, strain, damage, flow, slope, material, kind, hardening):
    """First guess, on the yield surface, with linearised growth of strength and f.

    The surface is beta q_trial / S = r cos(phi), sinh(|h|/2) = r/r_h sin(phi) with
    r^2 = 1 - 2 q1 f* + q3 f*^2 and r_h^2 = 4 q1 f*; R1 falls from phi = 0 to pi/2 and is solved in
    t = tan(phi/2) by Newton within brackets, to the few digits that the linearisation is worth.
    flow, slope: S and its derivative by plastic strain at the start of the step.
    """
    q2, shear = material[Q2], material[SHEAR]
    g, _ = effective_damage(damage, material)
    radius, reach, grow = _surface(g, material)
    # without pressure: radial return of the deviator, by two steps of Newton
    step = max(mises - radius * flow, 0.0) / (3.0 * shear + radius * slope)
    flow, slope = flow_stress(kind, hardening, strain + step)
    flow, slope = flow * jacobian, slope * jacobian
    if g <= 0.0:
        more = (mises - 3.0 * shear * step - radius * flow) / (3.0 * shear + radius * slope)
        return 0.0, min(1.0, max(flow + slope * more, 1e-3 * flow) * radius / mises)
    size, soft = abs(volume), 1.5 * q2 * material[BULK]
    strength, lagged = flow, material[LAGGED] > 0.0 and volume >= 0.0
    low, high = 0.0, 1.0
    ratio = radius * strength / max(mises, 1e-9 * strength)
    if ratio > 1.0:  # beta <= 1
        low = np.sqrt((ratio - 1.0) / (ratio + 1.0))
    t = 0.5 * (low + high)
    sine = _sinh(0.5 * soft * size / strength) / reach
    if sine < 0.7:  # no volume change
        t = max(low, sine / (1.0 + np.sqrt(1.0 - sine * sine)))
    for _ in range(_START_ITERATIONS):
        per_h = strength / soft
        value, gradient, beta, change = _flow_direction(
            t, ratio, reach, size, per_h, 2.0 * grow * strength
        )
        if value > 0.0:
            low = t
        else:
            high = t
        following = t - value / gradient
        if not (low <= following <= high):
            following = 0.5 * (low + high)
        moved = abs(following - t)
        t = following
        shrunk = (1.0 - beta) * mises / (3.0 * shear)
        strength = flow + slope * (np.sqrt(shrunk * shrunk + 2.0 / 9.0 * change * change) - step)
        if not lagged:
            f = damage + (1.0 - damage) * (change if volume > 0.0 else -change)
            g, _ = effective_damage(min(max(f, 1e-3 * damage), material[LIMIT]), material)
            radius, reach, grow = _surface(g, material)
        ratio = radius * strength / max(mises, 1e-9 * strength)
        if moved <= 1e-2 * t:
            break
    over = 1.0 / (1.0 + t * t)
    beta, half = ratio * (1.0 - t * t) * over, reach * 2.0 * t * over
    change = size - 2.0 * per_h * np.log(half + np.sqrt(1.0 + half * half))
    beta = min(max(beta, 1e-3 * min(ratio, 1.0)), 1.0)
    change = min(max(change, 0.0), size)
    if volume < 0.0:
        return -min(change, -0.5 * np.log1p(-damage)), beta
    return change, beta


@kernel
def _surface(g, material):
    """r and r / r_h of `_start`, and what the strain of R1 is per S sinh h, all for f* = g."""
    q1 = material[Q1]
    radius = np.sqrt(1.0 - 2.0 * q1 * g + material[Q3] * g * g)
    grow = 0.5 * q1 * material[Q2] * g / material[SHEAR]
    return radius, radius / np.sqrt(4.0 * q1 * g), grow


@kernel
def _flow_direction(t, ratio, reach, size, per_h, drive):
    """R1 of `_start` and its slope by t; beta and the plastic volume strain there."""
    over = 1.0 / (1.0 + t * t)
    cosine, sine = (1.0 - t * t) * over, 2.0 * t * over
    beta, half = ratio * cosine, reach * sine
    root = np.sqrt(1.0 + half * half)
    change = size - 2.0 * per_h * np.log(half + root)
    open_up = drive * half * root
    value = change * beta - (1.0 - beta) * open_up
    # d(phi) = 2 over dt
    d_beta, d_half = -2.0 * over * ratio * sine, 2.0 * over * reach * cosine
    d_open = drive * (1.0 + 2.0 * half * half) / root
    gradient = (change + open_up) * d_beta
    gradient -= (2.0 * per_h / root * beta + (1.0 - beta) * d_open) * d_half
    return value, gradient, beta, change


@kernel
def return_map(volume, mises, jacobian, strain, damage, material, kind, hardening):
    """Return the plastic step from an elastic trial state.

    volume: trial elastic volume strain; mises: trial equivalent Kirchhoff stress [Pa]; jacobian:
    det F; strain: plastic strain at the start of the step; damage: f there, or the f that is to act
    in the step (LAGGED); material: parameter vector; kind, hardening: the hardening law.

    Returns (a, beta, strain, f, flow, a_v, b_v, a_q, b_q): the solution, the new state, S, and
    the derivatives of a and beta by `volume` and `mises`. An elastic step gives a = 0, beta = 1
    and zero derivatives. The derivative by volume includes that of J, since d ln J = d volume.
    """
    flow, slope = flow_stress(kind, hardening, strain)
    flow *= jacobian
    g, _ = effective_damage(damage, material)
    strength = 1.0 - 2.0 * material[Q1] * g + material[Q3] * g * g
    trial = yield_function(mises, material[BULK] * volume, flow, damage, material)
    if trial <= 1e-10 * strength:
        return 0.0, 1.0, strain, damage, flow, 0.0, 0.0, 0.0, 0.0
    low, high = min(volume, 0.0), max(volume, 0.0)
    if volume < 0.0:
        low = max(low, np.log1p(-damage))
    a, beta = _start(
        volume, mises, jacobian, strain, damage, flow, slope * jacobian, material, kind, hardening
    )
    converged = False
    first, second, state = _system(
        a, beta, volume, mises, jacobian, strain, damage, material, kind, hardening
    )
    for _ in range(_NEWTON_ITERATIONS):
        if abs(first[0]) <= 1e-10 * state[3] + 1e-22 and abs(second[0]) <= 1e-11 * state[4]:
            converged = True
            break
        determinant = first[1] * second[2] - first[2] * second[1]
        if not determinant != 0.0 or not np.isfinite(determinant):
            break
        step_a = -(first[0] * second[2] - first[2] * second[0]) / determinant
        step_b = -(first[1] * second[0] - first[0] * second[1]) / determinant
        new_a, new_b = a + step_a, beta + step_b
        if new_a < low:
            new_a = 0.5 * (a + low) if a > low else low
        elif new_a > high:
            new_a = 0.5 * (a + high) if a < high else high
        if new_b <= 0.0:
            new_b = 0.2 * beta
        elif new_b > 1.0:
            new_b = 0.5 * (beta + 1.0)
        a, beta = new_a, new_b
        first, second, state = _system(
            a, beta, volume, mises, jacobian, strain, damage, material, kind, hardening
        )
    if not converged:
        a, beta = _bracketed(volume, mises, jacobian, strain, damage, material, kind, hardening)
        first, second, state = _system(
            a, beta, volume, mises, jacobian, strain, damage, material, kind, hardening
        )
    determinant = first[1] * second[2] - first[2] * second[1]
    a_v = b_v = a_q = b_q = 0.0
    if determinant != 0.0 and np.isfinite(determinant):
        a_v = -(first[3] * second[2] - first[2] * second[3]) / determinant
        b_v = -(first[1] * second[3] - first[3] * second[1]) / determinant
        a_q = -(first[4] * second[2] - first[2] * second[4]) / determinant
        b_q = -(first[1] * second[4] - first[4] * second[1]) / determinant
    return a, beta, state[0], state[1], state[2], a_v, b_v, a_q, b_q
