"""Forms of the effects in mechanics, mount and neighbouring axes. The strength grows the effect."""

import math

import numpy as np
from concealed.alien import kernels
from concealed.alien.electrical import LISTED, log_uniform
from concealed.alien.rig import Drawn

MODES = ("resonance", "second_mode")
FRICTION = ("stiction", "backlash")


def mode_hz(rng, rig):
    """A frequency that the recording can show: some periods of it, some samples in each."""
    return log_uniform(rng, max(0.03 * rig.fs_hz, 8 / rig.duration_s), 0.3 * rig.fs_hz)


def oscillate(x, at, hz, zeta, drag=0.0, branch=0.0, tau_s=1.0, stiffer=0.0, pump=0.0, pump_hz=0.0):
    """The displacement behind a mode; what is not given is linear."""
    omega = 2 * math.pi * hz
    return kernels.oscillator(
        x, omega, zeta, drag, branch, tau_s, stiffer, pump, 2 * math.pi * pump_hz, at.dt
    )


@LISTED.add("resonance", "drag_of_the_second_power", "Bert 1973", "mechanics", *MODES)
def _drag(rng, rig, runs):
    zeta, drag = log_uniform(rng, 0.004, 0.03), rng.uniform(5, 50) / rig.range_um
    first = mode_hz(rng, rig)
    return Drawn(
        lambda x, at, s: oscillate(x, at, rig.fs_hz / s, zeta, drag),
        2.6,
        max(2.7, min(60.0, rig.fs_hz * rig.duration_s / 8)),
        rig.fs_hz / first,
        lambda s: {"frequency_hz": (rig.fs_hz / s, "Hz")},
    )


@LISTED.add("resonance", "standard_linear_solid", "Zener 1948", "mechanics", *MODES)
def _solid(rng, rig, runs):
    first, branch = mode_hz(rng, rig), rng.uniform(0.05, 0.2)
    tau = rng.uniform(0.3, 2) / (2 * math.pi * first)
    return Drawn(
        lambda x, at, s: oscillate(x, at, rig.fs_hz / s, 0.002, 0.0, branch, tau),
        2.6,
        max(2.7, min(60.0, rig.fs_hz * rig.duration_s / 8)),
        rig.fs_hz / first,
    )


@LISTED.add("second_mode", "tuned_absorber", "Den Hartog 1934", "mechanics", *MODES)
def _absorber(rng, rig, runs):
    hz, zeta, ratio = mode_hz(rng, rig), log_uniform(rng, 0.005, 0.03), rng.uniform(0.9, 1.2)
    mass = rng.uniform(0.03, 0.3)

    def act(x, at, s):
        w = kernels.warped(hz, at.dt)
        small = [1 / (ratio * w) ** 2, 2 * zeta / (ratio * w), 1]
        carried = np.array([*small[1:], 0, 0]) * mass / w**2  # the absorber's inertia, as the host feels it
        host = np.polymul([1 / w**2, 2 * zeta / w, 1], small)
        return (1 - s) * x + s * kernels.linear(small, np.polyadd(host, carried).tolist(), x, at.dt)

    return Drawn(act, 1e-4, 0.6, 0.1)


@LISTED.add("second_mode", "standard_linear_solid", "Zener 1948", "mechanics", *MODES)
def _second_solid(rng, rig, runs):
    hz, branch = mode_hz(rng, rig), rng.uniform(0.05, 0.2)
    tau = rng.uniform(0.3, 2) / (2 * math.pi * hz)
    act = lambda x, at, s: (1 - s) * x + s * oscillate(x, at, hz, 0.002, 0.0, branch, tau)  # noqa: E731
    return Drawn(act, 1e-4, 0.6, 0.1)


@LISTED.add("load_change", "hardening_spring", "Duffing 1918", "mechanics", "sensor_nonlinearity")
def _hardening(rng, rig, runs):
    bend = rng.uniform(1, 4) / rig.range_um**2

    def act(x, at, s):
        if not at.run.loaded:
            return x
        y = x / (1 + s)
        for _ in range(12):  # Newton: y (1 + s + s b y²) = x
            y -= (y * (1 + s + s * bend * y * y) - x) / (1 + s + 3 * s * bend * y * y)
        return y

    return Drawn(act, 1e-5, 0.5, 0.05)


@LISTED.add(
    "load_change", "spring_that_is_met_on_the_way", "Johnson 1985", "mechanics", "sensor_nonlinearity"
)
def _met(rng, rig, runs):
    contact = rng.uniform(0.2, 0.6) * rig.range_um * rig.sign

    def act(x, at, s):
        beyond = np.maximum((x - contact) * rig.sign, 0) * rig.sign
        return x - beyond * s / (1 + s) if at.run.loaded else x

    return Drawn(act, 1e-5, 0.8, 0.05)


@LISTED.add("backlash", "gap_with_spring_and_damper", "Nordin and Gutman 2002", "mount", *FRICTION)
def _soft_gap(rng, rig, runs):
    tau = rng.uniform(0.02, 0.2) / rig.fs_hz
    act = lambda x, at, s: kernels.gap(x, s * rig.range_um, 0.0, tau, at.dt)  # noqa: E731
    return Drawn(act, 1e-6, 0.04, 3e-3, lambda s: {"width_um": (2 * s * rig.range_um, "um")})


@LISTED.add("backlash", "width_that_follows_the_position", "Tao and Kokotović 1996", "mount", *FRICTION)
def _skewed_gap(rng, rig, runs):
    skew = rng.uniform(-0.8, 2.0) / rig.range_um
    act = lambda x, at, s: kernels.gap(x, s * rig.range_um, skew, 0.0, at.dt)  # noqa: E731
    return Drawn(act, 1e-6, 0.04, 3e-3)


@LISTED.add("stiction", "lugre", "Canudas de Wit, Olsson, Åström and Lischinsky 1995", "mount", *FRICTION)
def _lugre(rng, rig, runs):
    ratio = rng.uniform(1.3, 2.5)
    stribeck = rng.uniform(0.02, 0.2) * rig.range_um / rig.duration_s * 20

    def act(x, at, s):
        f = s * rig.range_um
        return kernels.bristles(x, f, ratio * f, stribeck, 0.05 * f, at.dt)

    return Drawn(act, 1e-6, 0.03, 2e-3)


@LISTED.add("stiction", "dahl", "Dahl 1968", "mount", *FRICTION, foreign=False)
def _dahl(rng, rig, runs):
    length = rng.uniform(0.05, 1.0)

    def act(x, at, s):
        f = s * rig.range_um
        return kernels.bristles(x, f, f, 1.0, length * f, at.dt)

    return Drawn(act, 1e-6, 0.03, 2e-3)


@LISTED.add("cross_coupling", "behind_a_lag", "Devasia, Eleftheriou and Moheimani 2007", "mount")
def _lagged(rng, rig, runs):
    tau, gain = rng.uniform(2, 30) / rig.fs_hz, rng.choice([-1.0, 1.0]) * rig.range_um / rig.span_v

    def act(x, at, s):
        return x + s * gain * kernels.relaxed(np.repeat(at.run.aux, rig.fine), tau, at.dt)

    return Drawn(act, 1e-6, 0.3, 0.01, lambda s: {"coupling_um_per_v": (s * gain, "um/V")})


@LISTED.add("cross_coupling", "with_a_cosine_error", "Slocum 1992", "mount")
def _cosine(rng, rig, runs):
    gain, share = rng.choice([-1.0, 1.0]) * rig.range_um / rig.span_v, rng.uniform(0.3, 0.8)

    def act(x, at, s):
        a = np.repeat(at.run.aux, rig.fine)
        return x + s * gain * ((1 - share) * a + share * a * a / rig.span_v)

    return Drawn(act, 1e-6, 0.3, 0.01)
