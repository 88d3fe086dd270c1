"""Effects that are on nobody's list: eleven of the published plant's, and ten more."""

import math

import numpy as np
from concealed.alien import kernels
from concealed.alien.electrical import STATIC, log_uniform
from concealed.alien.mechanical import mode_hz, oscillate
from concealed.alien.rig import Drawn, Form, Forms
from concealed.plant.unknowns import UNKNOWNS

OPEN = Forms()
BY_ITSELF = {
    "gain_random_walk",
    "timebase_jitter",
    "aliased_tone",
    "sensor_glitches",
    "repeated_samples",
    "regime_switch",
}


def _published(unknown):
    def draw(rng, rig, runs):
        act, low, high, start = unknown.propose(rng, rig)
        return Drawn(lambda x, at, s: act(x, at.dt, rig.seed + at.run.number, s), low, high, start)

    place = "reading" if unknown.place == "sensor" else unknown.place
    foreseeable = unknown.name not in BY_ITSELF
    return Form(unknown.name, "published", unknown.equation, place, draw, True, foreseeable, unknown.near)


OPEN.all.extend(_published(unknown) for unknown in UNKNOWNS.values())


@OPEN.add("cyclic_error", "quadrature", "Heydemann 1981", "sensor", "quantization")
def _cyclic(rng, rig, runs):
    period, phase = min(rng.choice([0.316, 0.158]), 0.2 * rig.range_um), rng.uniform(0, 2 * math.pi)
    return Drawn(
        lambda x, at, s: x + s * np.sin(2 * math.pi * x / period + phase),
        0.1 * rig.noise_um,
        0.3 * period,
        rig.noise_um,
    )


@OPEN.add("crossover_notch", "class_b", "Self 2013", "amplifier", *STATIC, "sensor_nonlinearity")
def _notch(rng, rig, runs):
    middle, width = rng.uniform(0.2, 0.7) * rig.span_v, rng.uniform(0.01, 0.05) * rig.span_v
    act = lambda u, at, s: u - s * (u - middle) * np.exp(-(((u - middle) / width) ** 2))  # noqa: E731
    return Drawn(act, 1e-4, 1.0, 0.1)


@OPEN.add(
    "pumped_mode",
    "mathieu",
    "Nayfeh and Mook 1979",
    "mechanics",
    "resonance",
    "second_mode",
    foreseeable=False,
)
def _pumped(rng, rig, runs):
    hz, zeta, pump = mode_hz(rng, rig), rng.uniform(0.02, 0.06), rng.uniform(0.02, 0.06)
    act = lambda x, at, s: (1 - s) * x + s * oscillate(x, at, hz, zeta, pump=pump, pump_hz=1.7 * hz)  # noqa: E731
    return Drawn(act, 1e-4, 1.0, 0.2)


@OPEN.add(
    "end_stop",
    "compliant",
    "Johnson 1985",
    "mount",
    "voltage_saturation",
    "load_change",
    *STATIC,
    "sensor_nonlinearity",
)
def _end_stop(rng, rig, runs):
    stop = rng.uniform(0.5, 0.8) * rig.range_um
    return Drawn(lambda x, at, s: x - rig.sign * s * np.maximum(x * rig.sign - stop, 0), 1e-6, 0.95, 0.1)


@OPEN.add(
    "self_heating",
    "dielectric_loss",
    "Zheng et al. 1996",
    "actuator",
    "gain_modulation",
    "ageing",
    "rate_dependent_hysteresis",
)
def _self_heating(rng, rig, runs):
    tau = rig.duration_s * log_uniform(rng, 0.05, 0.5)

    def act(x, at, s):
        power = np.gradient(kernels.relaxed(x, 3 / rig.fs_hz, at.dt), at.dt) ** 2
        heat = kernels.relaxed(power, tau, at.dt)
        return x * (1 + s * heat / (np.max(heat) + 1e-30))

    return Drawn(act, 1e-6, 0.5, 1e-2)


@OPEN.add("echo", "reflection", "Johnson and Graham 1993", "sensor", "delay")
def _echo(rng, rig, runs):
    late = int(rng.integers(20, 200)) * rig.fine

    def act(x, at, s):
        return x + s * np.concatenate([np.zeros(late), x[:-late]])

    return Drawn(act, 1e-6, 0.5, 1e-2)


@OPEN.add(
    "tracking_converter", "slewing_sensor", "Kester 2005", "sensor", "slew_limit", "sensor_lag", "delay"
)
def _tracking(rng, rig, runs):
    ratio = rng.uniform(0.5, 1.0)
    steepest = rig.range_um * rig.fs_hz / 20
    act = lambda x, at, s: kernels.uneven_slew(x, steepest / s, ratio * steepest / s, at.dt)  # noqa: E731
    return Drawn(act, 1e-2, 1e4, 1.0)


@OPEN.add(
    "supply_sag",
    "by_the_current",
    "Horowitz and Hill 2015",
    "amplifier",
    "amplifier_lag",
    "slew_limit",
    "rate_dependent_hysteresis",
)
def _sag(rng, rig, runs):
    tau = log_uniform(rng, 20 / rig.fs_hz, max(0.1 * rig.duration_s, 40 / rig.fs_hz))

    def act(u, at, s):
        current = np.abs(np.diff(u, prepend=u[0])) / rig.span_v
        drawn = kernels.relaxed(current, tau, at.dt) * rig.fine * tau * rig.fs_hz
        return u * (1 - s * drawn / (1 + drawn))

    return Drawn(act, 1e-6, 0.9, 1e-2)


@OPEN.add(
    "barkhausen_jumps", "coarse_relays", "Mayergoyz 2003", "hysteresis", *STATIC, "stiction", "backlash"
)
def _barkhausen(rng, rig, runs):
    count = int(rng.integers(3, 12))
    up = rng.uniform(0.1, 0.95, count) * rig.span_v
    down = up - rng.uniform(0.05, 0.3, count) * rig.span_v

    def act(v, at, s):
        jumps = np.zeros(v.size)
        for high, low in zip(up, down, strict=True):
            event = np.where(v >= high, 1, np.where(v <= low, 0, -1))
            last = np.maximum.accumulate(np.where(event >= 0, np.arange(v.size), -1))
            jumps += np.where(last >= 0, event[np.maximum(last, 0)], 0)
        return rig.truth.respond(v) + s * rig.range_um * jumps / count

    return Drawn(act, 1e-5, 0.3, 1e-2)


@OPEN.add("clock_skew", "two_clocks", "Mills 1991", "sensor", "delay")
def _skew(rng, rig, runs):
    def act(x, at, s):
        start, place = at.run.history * rig.fine, np.arange(x.size, dtype=float)
        place[start:] -= s * rig.fine * np.linspace(0, 1, x.size - start)
        return np.interp(place, np.arange(x.size), x)

    return Drawn(act, 1e-3, 30.0, 1.0)
