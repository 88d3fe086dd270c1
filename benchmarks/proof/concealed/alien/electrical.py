"""Forms of the effects in the converter, the amplifier and the ceramic. The strength grows the effect."""

import math

import numpy as np
from concealed.alien import kernels
from concealed.alien.hysteresis import envelopes
from concealed.alien.rig import Drawn, Forms
from scipy.signal import bessel

LISTED = Forms()
STATIC = ("input_nonlinearity", "hysteresis_asymmetry", "incongruent_loops", "hysteresis_operator")


def log_uniform(rng, low, high):
    """A draw that is uniform in the logarithm."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


@LISTED.add("amplifier_lag", "bessel_third_order", "Thomson 1949", "amplifier", "delay")
def _bessel(rng, rig, runs):
    def act(u, at, s):
        b, a = bessel(3, 2 * math.pi * rig.fs_hz / s, analog=True, norm="mag")
        return kernels.linear(b, a, u, at.dt)

    return Drawn(act, 0.35, 2000.0, 5.0, lambda s: {"cutoff_hz": (rig.fs_hz / s, "Hz")})


@LISTED.add("amplifier_lag", "second_order_with_current_limit", "Fleming 2009", "amplifier", "slew_limit")
def _limited(rng, rig, runs):
    zeta, most = rng.uniform(0.5, 1.0), rng.uniform(1.2, 3.0) * _steepest(rig, runs)

    def act(u, at, s):
        return kernels.limited_second_order(u, 2 * math.pi * rig.fs_hz / s, zeta, most, at.dt)

    return Drawn(act, 1.0, 2000.0, 6.0, lambda s: {})


def _steepest(rig, runs):
    return max(float(np.quantile(np.abs(np.diff(run.u)), 0.98)) for run in runs) * rig.fs_hz + 1e-9


@LISTED.add("slew_limit", "current_limit_of_second_order", "Fleming 2009", "amplifier", "amplifier_lag")
def _current(rng, rig, runs):
    zeta, steepest = rng.uniform(0.6, 1.0), _steepest(rig, runs)
    omega = 2 * math.pi * rig.fs_hz
    act = lambda u, at, s: kernels.limited_second_order(u, omega, zeta, steepest / s, at.dt)  # noqa: E731
    return Drawn(act, 0.3, 300.0, 3.0, lambda s: {"limit_v_per_s": (steepest / s, "V/s")})


@LISTED.add("slew_limit", "source_and_sink_differ", "Horowitz and Hill 2015", "amplifier")
def _uneven(rng, rig, runs):
    ratio, steepest = rng.uniform(0.4, 0.8), _steepest(rig, runs)
    act = lambda u, at, s: kernels.uneven_slew(u, steepest / s, ratio * steepest / s, at.dt)  # noqa: E731
    return Drawn(act, 0.1, 300.0, 3.0)


@LISTED.add("voltage_saturation", "soft_rail", "Rapp 1991", "amplifier", "input_nonlinearity")
def _rapp(rng, rig, runs):
    p, top = rng.uniform(4, 12), max(float(np.max(np.abs(run.u))) for run in runs)

    def act(u, at, s):
        return u / (1 + np.abs(u * s / top) ** (2 * p)) ** (0.5 / p)

    return Drawn(act, 0.4, 1.6, 1.0)


@LISTED.add("voltage_saturation", "knee", "Åström and Murray 2008", "amplifier", "input_nonlinearity")
def _knee(rng, rig, runs):
    top, slope = max(float(run.u.max()) for run in runs), rng.uniform(0.0, 0.3)

    def act(u, at, s):
        level = top * (1 - s)
        return np.where(u > level, level + slope * (u - level), u)

    return Drawn(act, 1e-5, 0.4, 0.02, lambda s: {"upper_v": (top * (1 - s), "V")})


@LISTED.add("input_nonlinearity", "electrostriction", "Damjanovic 1998", "amplifier")
def _electrostriction(rng, rig, runs):
    sign = rng.choice([-1.0, 1.0])
    return Drawn(
        lambda u, at, s: u + sign * s * np.log(np.cosh(u / rig.span_v * 3)) * rig.span_v, 1e-5, 0.2, 0.01
    )


@LISTED.add("input_nonlinearity", "saturating_polarisation", "Smith 2005", "amplifier")
def _polarisation(rng, rig, runs):
    def act(u, at, s):
        return np.arctan(s * u / rig.span_v) / s * rig.span_v

    return Drawn(act, 3e-3, 2.0, 0.2)


def _bank(rng, count=24):
    r = np.sort(rng.gamma(2.0, 0.12, count))
    return r, rng.uniform(0.2, 1.8, count) / count


@LISTED.add(
    "hysteresis_asymmetry", "tanh_envelopes", "Al Janaideh, Rakheja and Su 2009", "hysteresis", *STATIC
)
def _tanh(rng, rig, runs):
    r, w = _bank(rng)
    shift = rng.uniform(0.1, 0.4) * rng.choice([-1, 1])

    def act(v, at, s):
        x = v / rig.span_v
        change = envelopes(x, r, w, 1.2, 0.8, shift) - envelopes(x, r, w, 1.0, 1.0, 0.0)
        return rig.truth.respond(v) + s * rig.range_um * change

    return Drawn(act, 1e-4, 3.0, 0.2)


@LISTED.add(
    "hysteresis_asymmetry", "one_sided_plays_of_a_bent_input", "Gu, Yang and Zhu 2012", "hysteresis", *STATIC
)
def _one_sided(rng, rig, runs):
    r, w = _bank(rng)
    rise = rng.uniform(0.5, 1.0)

    def act(v, at, s):
        bent = np.maximum(v / rig.span_v, 0) ** 2
        return rig.truth.respond(v) + s * rig.range_um * (
            envelopes(rise * bent, r, w, 0.1, 0.1, 0.0) - 0.5 * bent
        )

    return Drawn(act, 1e-4, 3.0, 0.1)


@LISTED.add("incongruent_loops", "moving_model", "Della Torre 1966", "hysteresis", *STATIC)
def _moving(rng, rig, runs):
    sign, gain = rng.choice([-1.0, 1.0]), rig.range_um / rig.span_v

    def act(v, at, s):
        x = rig.truth.respond(v)
        for _ in range(2):  # fixed point; the feedback is weak
            x = rig.truth.respond(v + sign * s * rig.span_v * np.tanh(x / gain / rig.span_v) ** 2)
        return x

    return Drawn(act, 1e-4, 0.3, 0.03)


@LISTED.add("incongruent_loops", "outputs_of_plays", "Visone and Sjöström 2004", "hysteresis", *STATIC)
def _outputs(rng, rig, runs):
    edges = np.sort(rng.uniform(0.05, 0.6, 5))

    def act(v, at, s):
        one = np.ones(1)
        plays = [envelopes(v / rig.span_v, one * r, one, 1e-3, 1e-3, 0.0) for r in edges]
        return rig.truth.respond(v) + s * rig.range_um * sum(np.expm1(h) - h for h in plays)

    return Drawn(act, 1e-4, 2.0, 0.05)


@LISTED.add("hysteresis_operator", "another_family", "Mayergoyz 2003", "hysteresis", *STATIC)
def _mixed(rng, rig, runs):
    act = lambda v, at, s: (1 - s) * rig.truth.respond(v) + s * rig.other.respond(v)  # noqa: E731
    return Drawn(act, 1e-4, 1.0, 0.3)


@LISTED.add("hysteresis_operator", "cascade_of_two", "Brokate and Sprekels 1996", "hysteresis", *STATIC)
def _cascade(rng, rig, runs):
    act = lambda v, at, s: rig.truth.respond(v + s * rig.span_v * (rig.other.respond(v) / rig.range_um))  # noqa: E731
    return Drawn(act, 1e-4, 1.0, 0.1)


@LISTED.add("rate_dependent_hysteresis", "excess_losses", "Bertotti 1988", "hysteresis", "amplifier_lag")
def _excess(rng, rig, runs):
    reference = _steepest(rig, runs)

    def act(v, at, s):
        smooth = kernels.relaxed(v, 2 / rig.fs_hz, at.dt)
        rate = np.gradient(smooth, at.dt) / reference
        return rig.truth.respond(v - s * rig.span_v * np.sign(rate) * np.sqrt(np.abs(rate)))

    return Drawn(act, 1e-5, 0.3, 0.01)


@LISTED.add("rate_dependent_hysteresis", "viscoelastic_slip", "Goldfarb and Celanovic 1997", "hysteresis")
def _slip(rng, rig, runs):
    tau = log_uniform(rng, 5 / rig.fs_hz, max(0.03 * rig.duration_s, 10 / rig.fs_hz))

    def act(v, at, s):
        x = rig.truth.respond(v)
        loop = x - rig.range_um / rig.span_v * v
        return x + s * (kernels.relaxed(loop, tau, at.dt) - loop)

    return Drawn(act, 1e-4, 1.0, 0.2)


@LISTED.add("creep", "fractional_power_law", "Liu, Shan, Gabbert and Qi 2013", "actuator", foreign=False)
def _power(rng, rig, runs):
    taus, power = np.geomspace(3 / rig.fs_hz, 30 * rig.duration_s, 16), rng.uniform(0.05, 0.35)
    gains = taus**power / np.sum(taus**power)

    def act(x, at, s):
        return x + s * sum(g * kernels.relaxed(x, tau, at.dt) for g, tau in zip(gains, taus, strict=True))

    return Drawn(act, 1e-4, 1.0, 0.05)


@LISTED.add("creep", "prandtl_ishlinskii_creep_operators", "Krejčí and Kuhnen 2001", "actuator")
def _threshold(rng, rig, runs):
    r = np.repeat(np.linspace(0, rng.uniform(0.1, 0.4), 5) * rig.range_um, 4)
    taus = np.tile(np.geomspace(0.02, 2.0, 4) * rig.duration_s, 5)
    weights = rng.uniform(0.5, 1.5, r.size) / r.size
    act = lambda x, at, s: x + s * kernels.threshold_creep(x, r, taus, weights, at.dt)  # noqa: E731
    return Drawn(act, 1e-4, 1.0, 0.05)


@LISTED.add("creep", "stretched_exponential", "Kohlrausch 1854; Lindsey and Patterson 1980", "actuator")
def _stretched(rng, rig, runs):
    beta, tau = rng.uniform(0.35, 0.7), rig.duration_s * log_uniform(rng, 0.02, 0.5)
    taus = np.geomspace(2e-3, 10, 12) * tau
    t = np.geomspace(1e-3, 20, 200) * tau
    shape = 1 - np.exp(-((t / tau) ** beta))
    gains = np.linalg.lstsq(1 - np.exp(-t[:, None] / taus), shape, rcond=None)[0]

    def act(x, at, s):
        return x + s * sum(g * kernels.relaxed(x, q, at.dt) for g, q in zip(gains, taus, strict=True))

    return Drawn(act, 1e-4, 0.5, 0.03)


@LISTED.add("leakage", "faster_where_charged", "Frenkel 1938", "actuator")
def _frenkel(rng, rig, runs):
    growth = rng.uniform(1, 4) / rig.range_um
    act = lambda x, at, s: kernels.leaking(x, s / rig.duration_s, growth, at.dt)  # noqa: E731
    return Drawn(act, 1e-5, 0.5, 0.01)


@LISTED.add("leakage", "constant_phase_element", "Oldham and Spanier 1974", "actuator")
def _constant_phase(rng, rig, runs):
    taus = np.geomspace(0.3, 30, 6) * rig.duration_s
    gains = taus ** rng.uniform(-0.4, 0.1)
    gains /= gains.sum()

    def act(x, at, s):
        return x - s * sum(g * kernels.relaxed(x, tau, at.dt) for g, tau in zip(gains, taus, strict=True))

    return Drawn(act, 1e-5, 0.9, 0.02)


@LISTED.add("ageing", "logarithmic_depoling", "Jaffe, Cook and Jaffe 1971", "actuator", "gain_modulation")
def _depoling(rng, rig, runs):
    tau = rig.duration_s * rng.uniform(0.01, 0.2)

    def act(x, at, s):
        t = np.maximum(np.arange(x.size) - at.run.history * rig.fine, 0) * at.dt
        return x * (1 - s * np.log10(1 + t / tau))

    return Drawn(act, 1e-6, 0.3, 1e-3)


@LISTED.add("ageing", "by_load_cycles", "Lupascu and Rödel 2005", "actuator", "gain_modulation")
def _cycles(rng, rig, runs):
    power = rng.uniform(0.5, 1.0)

    def act(x, at, s):
        worn = kernels.swings(x[at.run.history * rig.fine :], 0.05 * rig.range_um) / rig.range_um**2
        worn = np.concatenate([np.zeros(x.size - worn.size), worn])
        return x * np.exp(-s * worn**power)

    return Drawn(act, 1e-7, 0.3, 1e-3)
