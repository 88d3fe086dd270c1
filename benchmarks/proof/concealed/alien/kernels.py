"""Memory and motion on the fine time grid, each from rest, one step at a time."""

import math

import numba
import numpy as np
from concealed.plant.physics import Array
from scipy.signal import bilinear, lfilter


def linear(numerator: list[float], denominator: list[float], x: Array, dt: float) -> Array:
    """A transfer function in s, by the trapezoidal rule."""
    return lfilter(*bilinear(numerator, denominator, 1 / dt), x)


def warped(frequency_hz: float, dt: float) -> float:
    """The rate, rad/s, at which the trapezoidal rule has a pole of this frequency."""
    return 2 / dt * math.tan(math.pi * frequency_hz * dt)


def relaxed(x: Array, tau_s: float, dt: float) -> Array:
    """x behind one relaxation."""
    decay = math.exp(-dt / tau_s)
    return lfilter([1 - decay], [1, -decay], x)


@numba.njit(cache=True)
def limited_second_order(u, omega, zeta, most_per_s, dt):
    """v'' = ω²(u - v) - 2ζω v', |v'| at most what the current charges; symplectic Euler."""
    v, rate, out = 0.0, 0.0, np.empty(u.size)
    for t in range(u.size):
        rate = (rate + dt * omega * omega * (u[t] - v)) / (1 + 2 * dt * zeta * omega)
        rate = min(max(rate, -most_per_s), most_per_s)
        v += dt * rate
        out[t] = v
    return out


@numba.njit(cache=True)
def uneven_slew(u, source_per_s, sink_per_s, dt):
    """A stage that sources and sinks different currents."""
    v, out = 0.0, np.empty(u.size)
    for t in range(u.size):
        v += min(max(u[t] - v, -sink_per_s * dt), source_per_s * dt)
        out[t] = v
    return out


@numba.njit(cache=True)
def threshold_creep(x, thresholds, taus_s, weights, dt):
    """Σ w_i y_i, τ_i y_i' = max{x - y_i - r_i, min{x - y_i + r_i, 0}}."""
    states, out = np.zeros(thresholds.size), np.empty(x.size)
    gains = 1 - np.exp(-dt / taus_s)
    for t in range(x.size):
        total = 0.0
        for i in range(states.size):
            s = states[i]
            states[i] = s + gains[i] * (min(max(s, x[t] - thresholds[i]), x[t] + thresholds[i]) - s)
            total += weights[i] * states[i]
        out[t] = total
    return out


@numba.njit(cache=True)
def leaking(x, rate_hz, growth_per_um, dt):
    """y' = x' - 2πf y (1 + g |y|): charge that leaks faster the more there is."""
    y, last, out = 0.0, 0.0, np.empty(x.size)
    for t in range(x.size):
        y = (y + x[t] - last) / (1 + dt * 2 * math.pi * rate_hz * (1 + growth_per_um * abs(y)))
        last, out[t] = x[t], y
    return out


@numba.njit(cache=True)
def oscillator(x, omega, zeta, drag_per_um, branch, tau_s, stiffer_per_um, pump, pump_omega, dt):
    """y'' = ω²[(1 + κ e²)(x - y) + pump cos (Ω t)(x - y) - m] - 2ζω(1 + d |y'|/ω) y' by leapfrog.

    m is the force of a Maxwell branch, m' = b y' - m/τ; e = x - y.
    """
    y, rate, m, out = 0.0, 0.0, 0.0, np.empty(x.size)
    omega = 2 / dt * math.sin(omega * dt / 2)
    decay = math.exp(-dt / tau_s)
    for t in range(x.size):
        e = x[t] - y
        force = (1 + stiffer_per_um * e * e + pump * math.cos(pump_omega * t * dt)) * e - m
        rate = rate + dt * omega * omega * force
        rate = rate / (1 + 2 * dt * zeta * omega * (1 + drag_per_um * abs(rate) / omega))
        y += dt * rate
        m = decay * (m + branch * dt * rate)
        out[t] = y
    return out


@numba.njit(cache=True)
def bristles(x, coulomb_um, static_um, stribeck_um_per_s, presliding_um, dt):
    """A guide with the bristles of LuGre behind a spring, in µm of the spring: x - y = F.

    z' = y' - |y'| z / g, F = F(g) z / g at its own level; g falls from breakaway to sliding with the rate
    (static = coulomb is Dahl's friction). Implicit in the rate, by bisection.
    """
    y, share, out = 0.0, 0.0, np.empty(x.size)  # share = friction over its sliding level
    for t in range(x.size):
        pull = x[t] - y
        high = (abs(pull) + static_um) / dt
        low, rate, new = -high, 0.0, share
        for _ in range(20):
            rate = 0.5 * (low + high)
            level = coulomb_um + (static_um - coulomb_um) * math.exp(-((rate / stribeck_um_per_s) ** 2))
            sign = 1.0 if rate > 0 else -1.0
            new = sign + (share - sign) * math.exp(-abs(rate) * dt / presliding_um)
            if dt * rate + level * new > pull:
                high = rate
            else:
                low = rate
        share = new
        y += dt * rate
        out[t] = y
    return out


@numba.njit(cache=True)
def gap(x, half_um, skew_per_um, tau_s, dt):
    """A gap behind spring and damper; its width may follow the position: τ y' = dead zone(x - y)."""
    y, gain, out = 0.0, 1 - math.exp(-dt / tau_s) if tau_s > 0 else 1.0, np.empty(x.size)
    for t in range(x.size):
        half = half_um * max(1 + skew_per_um * x[t], 0.0)
        pull = x[t] - y
        y += gain * (pull - min(max(pull, -half), half))
        out[t] = y
    return out


@numba.njit(cache=True)
def dead_band(y, lsb):
    """A converter that truncates, and keeps its code until the signal is one and a half codes away."""
    out, code = np.empty(y.size), 0.0
    for t in range(y.size):
        if y[t] < (code - 0.5) * lsb or y[t] >= (code + 1.5) * lsb:
            code = math.floor(y[t] / lsb)
        out[t] = code * lsb
    return out


@numba.njit(cache=True)
def swings(x, smallest):
    """Σ of the squares of the swings between reversals so far, as they complete."""
    total, low, high, rising, out = 0.0, 0.0, 0.0, True, np.empty(x.size)
    for t in range(x.size):
        if rising:
            high = max(high, x[t])
            if x[t] < high - smallest:
                total += (high - low) ** 2
                rising, low = False, x[t]
        else:
            low = min(low, x[t])
            if x[t] > low + smallest:
                total += (high - low) ** 2
                rising, high = True, x[t]
        out[t] = total
    return out
