"""The dynamic and memory blocks of the chain, on the fine time grid, each starting from rest.

Explicit fourth-order Runge–Kutta with the input held over a fine step, without any matrix exponential, so
that no result agrees with another simulator's by construction.
"""

import math

import numba
import numpy as np


@numba.njit(cache=True)
def lag(x, cutoff_hz, dt):
    """ẏ = 2πf_c (x - y)."""
    a = 2 * math.pi * cutoff_hz * dt
    step = a - a**2 / 2 + a**3 / 6 - a**4 / 24  # the result of the four Runge–Kutta stages
    y, out = 0.0, np.empty(x.size)
    for t in range(x.size):
        y += step * (x[t] - y)
        out[t] = y
    return out


@numba.njit(cache=True)
def slew(x, limit_per_s, dt):
    """|ẏ| ≤ limit, otherwise y = x."""
    y, out, most = 0.0, np.empty(x.size), limit_per_s * dt
    for t in range(x.size):
        y += min(max(x[t] - y, -most), most)
        out[t] = y
    return out


@numba.njit(cache=True)
def high_pass(x, corner_hz, dt):
    """y = x - z, ż = 2πf (x - z): charge that leaks away."""
    a = 2 * math.pi * corner_hz * dt
    z, out = 0.0, np.empty(x.size)
    for t in range(x.size):
        z += (a - a**2 / 2 + a**3 / 6 - a**4 / 24) * (x[t] - z)
        out[t] = x[t] - z
    return out


@numba.njit(cache=True)
def creep(x, gains, taus_s, dt):
    """y = x + Σ g_i·z_i, τ_i·ż_i = x - z_i."""
    z = np.zeros(taus_s.size)
    a = dt / taus_s
    step = a - a**2 / 2 + a**3 / 6 - a**4 / 24
    out = np.empty(x.size)
    for t in range(x.size):
        y = x[t]
        for i in range(z.size):
            z[i] += step[i] * (x[t] - z[i])
            y += gains[i] * z[i]
        out[t] = y
    return out


@numba.njit(cache=True)
def _mode_slope(x, v, force, omega, damping, cubic, soft):
    w = omega * (1 + soft * force)
    stretch = x - force
    return v, -w * w * (stretch + cubic * stretch**3) - 2 * damping * w * v


@numba.njit(cache=True)
def mode(force, frequency_hz, damping, dt, cubic=0.0, soft=0.0):
    """ẍ + 2ζω₀ẋ + ω₀²(e + k₃e³) = 0, e = x - x_in; ω₀ changes by `soft` per µm of x_in."""
    omega = 2 * math.pi * frequency_hz
    x, v, out = 0.0, 0.0, np.empty(force.size)
    for t in range(force.size):
        f = force[t]
        a1, b1 = _mode_slope(x, v, f, omega, damping, cubic, soft)
        a2, b2 = _mode_slope(x + dt / 2 * a1, v + dt / 2 * b1, f, omega, damping, cubic, soft)
        a3, b3 = _mode_slope(x + dt / 2 * a2, v + dt / 2 * b2, f, omega, damping, cubic, soft)
        a4, b4 = _mode_slope(x + dt * a3, v + dt * b3, f, omega, damping, cubic, soft)
        x += dt / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        v += dt / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
        out[t] = x
    return out


@numba.njit(cache=True)
def backlash(x, half_gap):
    """A gap of twice `half_gap` between the drive and what it drives."""
    y, out = 0.0, np.empty(x.size)
    for t in range(x.size):
        y = min(max(y, x[t] - half_gap), x[t] + half_gap)
        out[t] = y
    return out


@numba.njit(cache=True)
def stick_slip(x, breakaway, sliding, rest_per_step):
    """Stick until the drive is `breakaway` ahead, then follow `sliding` behind until it rests or reverses."""
    y, stuck, sign, out = 0.0, True, 0.0, np.empty(x.size)
    for t in range(x.size):
        if not stuck:
            move = x[t] - x[t - 1]
            if move * sign <= rest_per_step:
                stuck = True
            else:
                y = x[t] - sign * sliding
        if stuck and abs(x[t] - y) > breakaway:
            stuck = False
            sign = 1.0 if x[t] > y else -1.0
            y = x[t] - sign * sliding
        out[t] = y
    return out


@numba.njit(cache=True)
def friction(x, coulomb, tau_s, dt):
    """A viscous guide with dry friction: τẏ is the pull x - y beyond `coulomb`, and zero within it."""
    y, out = 0.0, np.empty(x.size)
    for t in range(x.size):
        pull = x[t] - y
        free = math.copysign(max(abs(pull) - coulomb, 0.0), pull)
        y += min(dt / tau_s, 1.0) * free
        out[t] = y
    return out


@numba.njit(cache=True)
def dead_steps(u, smallest):
    """A converter that ignores a change smaller than `smallest` since its last change."""
    held, out = 0.0, np.empty(u.size)
    for k in range(u.size):
        if abs(u[k] - held) >= smallest:
            held = u[k]
        out[k] = held
    return out


@numba.njit(cache=True)
def travel(x):
    """Distance covered so far."""
    total, out = 0.0, np.empty(x.size)
    for t in range(x.size):
        if t:
            total += abs(x[t] - x[t - 1])
        out[t] = total
    return out
