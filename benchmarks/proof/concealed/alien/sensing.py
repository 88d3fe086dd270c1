"""Forms of the effects in the sensor, its converter and its surroundings. The strength grows the effect."""

import math

import numpy as np
from concealed.alien import kernels
from concealed.alien.electrical import LISTED, log_uniform
from concealed.alien.rig import Drawn
from scipy.signal import lfilter


@LISTED.add("delay", "whole_ticks_of_the_command", "Åström and Wittenmark 1997", "converter", foreign=False)
def _ticks(rng, rig, runs):
    def act(u, at, s):
        n = max(round(s), 1)
        return np.concatenate([np.zeros(n), u[:-n]])

    most = max(min(12.0, 0.02 * rig.samples), 2.0)
    return Drawn(act, 1.0, most, 1.0, lambda s: {"delay_s": (max(round(s), 1) / rig.fs_hz, "s")})


@LISTED.add("delay", "a_fraction_more_behind_the_stage", "Richard 2003", "sensor")
def _fraction(rng, rig, runs):
    def act(x, at, s):
        place = np.arange(x.size) - s * rig.fine
        return np.interp(place, np.arange(x.size), x)

    # Less than a tick is the hold's. Less than two may be no more than the other timing convention, which the
    # severity beyond plays allows for.
    return Drawn(act, 1.7, 12.0, 2.5, lambda s: {"delay_s": (s / rig.fs_hz, "s")})


@LISTED.add("sensor_lag", "second_order_demodulator", "Fleming 2013", "sensor", "delay", foreign=False)
def _demodulator(rng, rig, runs):
    zeta = rng.uniform(0.6, 0.9)

    def act(x, at, s):
        w = 2 * math.pi * rig.fs_hz / s
        return kernels.linear([1], [1 / w**2, 2 * zeta / w, 1], x, at.dt)

    return Drawn(act, 0.35, 2000.0, 5.0)


@LISTED.add("sensor_lag", "integrating_converter", "Kester 2005", "sensor", "delay")
def _integrating(rng, rig, runs):
    def act(x, at, s):
        n = max(round(s * rig.fine), 1)
        total = np.concatenate([np.zeros(n), np.cumsum(x)])
        return (total[n:] - total[:-n]) / n

    return Drawn(act, 0.15, 400.0, 3.0)


@LISTED.add("sensor_nonlinearity", "capacitive_gap", "Baxter 1997", "sensor", "input_nonlinearity")
def _capacitive(rng, rig, runs):
    sign = rng.choice([-1.0, 1.0])
    return Drawn(lambda x, at, s: x / (1 + sign * s * x / rig.range_um), 1e-5, 0.5, 0.01)


@LISTED.add("sensor_nonlinearity", "differential_transformer", "Fleming 2013", "sensor", "input_nonlinearity")
def _transformer(rng, rig, runs):
    centre = rng.uniform(-0.5, 0.5)

    def act(x, at, s):
        return rig.range_um / s * (np.arctan(s * (x / rig.range_um - centre)) + math.atan(s * centre))

    return Drawn(act, 0.01, 2.0, 0.2)


@LISTED.add("quantization", "uneven_codes", "Widrow and Kollár 2008", "code", foreseeable=False)
def _uneven_codes(rng, rig, runs):
    spread = rng.uniform(0.1, 0.3)

    def act(y, at, s):
        codes = np.round(y / s)
        offsets = np.random.default_rng([rig.seed, 31]).uniform(-spread, spread, 4096)
        return s * (codes + offsets[codes.astype(int) % 4096])

    return Drawn(
        act, 0.1 * rig.noise_um, 0.05 * rig.range_um, 5 * rig.noise_um, lambda s: {"lsb_um": (s, "um")}
    )


@LISTED.add(
    "quantization", "truncation_with_a_dead_band", "Kester 2005", "code", "backlash", foreseeable=False
)
def _dead_band(rng, rig, runs):
    act = lambda y, at, s: kernels.dead_band(y, s)  # noqa: E731
    return Drawn(
        act, 0.1 * rig.noise_um, 0.05 * rig.range_um, 3 * rig.noise_um, lambda s: {"lsb_um": (s, "um")}
    )


def sizes(rig):
    """From faint to a fifth of the range, of what is added to the readings, µm."""
    return 0.05 * rig.noise_um, max(0.2 * rig.range_um, rig.noise_um), 5 * rig.noise_um


def mains_hz(rng, rig):
    """The mains, or, where the recording is too slow or too short for it, its alias or multiple."""
    mains = float(rng.choice([50.0, 60.0]))
    if mains > 0.4 * rig.fs_hz:
        return abs(mains - rig.fs_hz * round(mains / rig.fs_hz)) or 0.21 * rig.fs_hz
    return mains * max(1, math.ceil(10 / (mains * rig.duration_s)))


@LISTED.add("hum", "frequency_that_wanders", "Machowski, Bialek and Bumby 2008", "reading", foreseeable=False)
def _wandering(rng, rig, runs):
    mains, wander = mains_hz(rng, rig), log_uniform(rng, 1e-4, 2e-3)
    third = rng.uniform(0, 0.4)

    def act(y, at, s):
        g = at.rng(32)
        slow = lfilter([1], [1, -0.999], g.standard_normal(y.size)) / 22
        phase = 2 * math.pi * np.cumsum(mains * (1 + wander * slow)) / rig.fs_hz + g.uniform(0, 6.28)
        return y + s * (np.sin(phase) + third * np.sin(3 * phase))

    return Drawn(act, *sizes(rig), lambda s: {"frequency_hz": (mains, "Hz")})


@LISTED.add("hum", "rectifier_ripple", "Horowitz and Hill 2015", "reading", foreseeable=False)
def _ripple(rng, rig, runs):
    mains, duty = mains_hz(rng, rig), rng.uniform(0.15, 0.5)

    def act(y, at, s):
        phase = (
            mains * at.time_s + at.rng(33).uniform()
        ) % 1  # charges for a share of each cycle, and decays
        return y + s * np.where(phase < duty, phase / duty, np.exp(-(phase - duty)) * 1.2 - 0.2)

    return Drawn(act, *sizes(rig), lambda s: {"frequency_hz": (mains, "Hz")})


@LISTED.add("thermal_drift", "diffusion", "Carslaw and Jaeger 1959", "reading", "leakage", foreseeable=False)
def _diffusion(rng, rig, runs):
    sign = rng.choice([-1.0, 1.0])

    def act(y, at, s):
        return y + sign * s * at.rng(34).uniform(0.6, 1.4) * np.sqrt(at.time_s / rig.duration_s)

    return Drawn(act, *sizes(rig))


@LISTED.add("thermal_drift", "two_heat_capacities", "Slocum 1992", "reading", "leakage", foreseeable=False)
def _two_capacities(rng, rig, runs):
    fast, slow = rig.duration_s * rng.uniform(0.05, 0.2), rig.duration_s * rng.uniform(0.4, 3)
    share = rng.uniform(0.3, 1.2)

    def act(y, at, s):
        t = at.time_s
        return y + s * at.rng(35).uniform(0.6, 1.4) * (
            1 - np.exp(-t / fast) - share * (1 - np.exp(-t / slow))
        )

    return Drawn(act, *sizes(rig))


@LISTED.add(
    "gain_modulation",
    "ornstein_uhlenbeck",
    "Uhlenbeck and Ornstein 1930",
    "reading",
    "ageing",
    foreseeable=False,
)
def _ornstein(rng, rig, runs):
    ticks = rig.samples * rng.uniform(0.05, 0.3)

    def act(y, at, s):
        decay = math.exp(-1 / ticks)
        g = at.rng(36)
        walk = lfilter(
            [math.sqrt(1 - decay**2)], [1, -decay], g.standard_normal(y.size), zi=[g.standard_normal()]
        )[0]
        return y * (1 + s * walk)

    return Drawn(act, 1e-6, 0.3, 1e-2)


@LISTED.add("gain_modulation", "a_line_that_sweeps", "Fleming 2013", "reading", foreseeable=False)
def _sweeping(rng, rig, runs):
    cycles, growth = rng.uniform(3, 12), rng.uniform(0.3, 1.5)

    def act(y, at, s):
        t = at.time_s / rig.duration_s
        return y * (
            1 + s * np.sin(2 * math.pi * cycles * (t + growth * t * t / 2) + at.rng(37).uniform(0, 6.28))
        )

    return Drawn(act, 1e-6, 0.3, 1e-2)


@LISTED.add("dropouts", "bits_that_flip", "Kester 2005", "reading", foreseeable=False)
def _bits(rng, rig, runs):
    bits = int(rng.integers(8, 13))

    def act(y, at, s):
        g = at.rng(38)
        hit = np.flatnonzero(g.random(y.size) < 2e-3)
        power = g.integers(0, bits, hit.size)
        out = y.copy()
        out[hit] += g.choice([-1, 1], hit.size) * s * 2.0 ** (power - bits)
        return out

    return Drawn(act, rig.noise_um, 1e3 * rig.range_um, 0.1 * rig.range_um)


@LISTED.add("dropouts", "the_last_reading_again_or_full_scale", "Fox 1972", "reading", foreseeable=False)
def _full_scale(rng, rig, runs):
    full = rng.uniform(1.1, 2.0) * rig.range_um

    def act(y, at, s):
        g = at.rng(39)
        hit, kind = 1 + np.flatnonzero(g.random(y.size - 1) < s), g.random(y.size)
        out = y.copy()
        out[hit] = np.where(kind[hit] < 0.5, y[hit - 1], np.sign(kind[hit] - 0.75) * full)
        return out

    return Drawn(act, 1e-6, 0.02, 1e-3)
