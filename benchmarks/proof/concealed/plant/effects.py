"""The effects on the list: what each does to a plain plant, how strong it may be, and its true parameters."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from concealed.plant.physics import Creep, Mode
from concealed.plant.rig import Rig, Run

Quantity = tuple[float, str]


@dataclass(frozen=True)
class Proposal:
    """An effect with everything drawn except its strength, which the severity determines.

    `change(strength)` gives the fields of `Physics`; `parameters(strength)` their true values with units.
    """

    change: Callable[[float], dict[str, object]]
    low: float
    high: float
    start: float
    parameters: Callable[[float], dict[str, Quantity]]


@dataclass(frozen=True)
class Effect:
    """A name, the block it lives in, its equation, and how a concealed one is drawn."""

    name: str
    block: str
    equation: str
    propose: Callable[[np.random.Generator, Rig, list[Run]], Proposal]


def _one(field: str, unit: str, low: float, high: float, start: float, name: str | None = None) -> Proposal:
    return Proposal(lambda s: {field: s}, low, high, start, lambda s: {name or field: (s, unit)})


def _fastest_hz(rig: Rig) -> float:
    return rig.fs_hz * rig.oversampling / (2 * math.pi)


def _amplifier_lag(rng, rig, runs):
    return _one("amplifier_cutoff_hz", "Hz", 1.0, min(160e3, _fastest_hz(rig)), rig.fs_hz / 4, "cutoff_hz")


def _slew_limit(rng, rig, runs):
    steepest = max(np.max(np.abs(np.diff(run.u))) for run in runs) * rig.fs_hz
    return _one("slew_v_per_s", "V/s", 2e-3 * steepest, 1.2 * steepest, 0.3 * steepest, "limit_v_per_s")


def _voltage_saturation(rng, rig, runs):
    top = max(run.u.max() for run in runs)
    # The strength is the share of the top that is cut off, so that it starts from zero.
    return Proposal(
        lambda s: {"upper_v": top * (1 - s)}, 1e-5, 0.3, 0.02, lambda s: {"upper_v": (top * (1 - s), "V")}
    )


def _delay(rng, rig, runs):
    period = 1 / rig.fs_hz
    most = max(min(10, int(2e-3 * rig.fs_hz)), 2)
    ticks = lambda s: max(1, round(s))  # noqa: E731  # whole ticks: a held command hides their fractions
    return Proposal(
        lambda s: {"delay_s": ticks(s) * period},
        1.0,
        most,
        1.0,
        lambda s: {"delay_s": (ticks(s) * period, "s")},
    )


def _input_nonlinearity(rng, rig, runs):
    cubic = rng.uniform(-0.5, 0.5) if rng.random() < 0.5 else 0.0
    sign = rng.choice([-1.0, 1.0])
    return Proposal(
        lambda s: {"c2_per_v": sign * s / rig.span_v, "c3_per_v2": sign * s * cubic / rig.span_v**2},
        1e-5,
        0.3,
        0.01,
        lambda s: {
            "c2_per_v": (sign * s / rig.span_v, "1/V"),
            "c3_per_v2": (sign * s * cubic / rig.span_v**2, "1/V^2"),
        },
    )


def _hysteresis_asymmetry(rng, rig, runs):
    return _one("envelope", "span", 1e-5, 0.3, 0.02, "envelope")


def _incongruent_loops(rng, rig, runs):
    sign = rng.choice([-1.0, 1.0])
    return Proposal(
        lambda s: {"incongruence": sign * s}, 1e-4, 1.5, 0.1, lambda s: {"widening_per_span": (sign * s, "1")}
    )


def _hysteresis_operator(rng, rig, runs):
    return _one("other_family_share", "1", 1e-4, 1.0, 0.3, "share")


def _rate_dependent_hysteresis(rng, rig, runs):
    reference = rig.span_v * np.exp(rng.uniform(np.log(0.3), np.log(10)))
    return Proposal(
        lambda s: {"rate_widening": s, "rate_reference_v_per_s": reference},
        1e-4,
        1.0,
        0.05,
        lambda s: {"widening_per_e": (s, "1"), "reference_rate_v_per_s": (reference, "V/s")},
    )


def _creep(rng, rig, runs):
    duration = runs[0].u.size / rig.fs_hz
    shortest, longest = 2 / rig.fs_hz, 10 * duration
    kind = rng.choice(["logarithmic", "power_law", "few_poles"])
    if kind == "few_poles":
        count = int(rng.integers(1, 4))
        taus = np.sort(np.exp(rng.uniform(np.log(0.02 * duration), np.log(duration), count)))
        gains = rng.uniform(0.5, 1.5, count)
    else:
        taus = np.geomspace(max(shortest, 1e-3), max(longest, 100.0), 23)
        gains = np.ones(taus.size) if kind == "logarithmic" else taus ** rng.uniform(0.05, 0.2)
    # The strength γ is the creep of a step between 0.1 and 1 of a hold that lasts a tenth of the recording.
    late, early = 0.1 * duration, 0.01 * duration
    per_decade = float(np.sum(gains * (np.exp(-early / taus) - np.exp(-late / taus))))
    gains = gains / per_decade

    def parameters(s: float) -> dict[str, Quantity]:
        values = {"per_decade": (s, "1")}
        if kind == "few_poles":
            values |= {f"tau_{i}_s": (float(tau), "s") for i, tau in enumerate(taus, 1)}
        return values

    return Proposal(lambda s: {"creep": Creep(tuple(s * gains), tuple(taus))}, 1e-5, 0.1, 0.01, parameters)


def _leakage(rng, rig, runs):
    return _one("leakage_hz", "Hz", 1e-5, 0.3, 0.01, "corner_hz")


def _mode_frequency(rng: np.random.Generator, rig: Rig) -> float:
    return float(
        np.exp(rng.uniform(np.log(min(200.0, 0.1 * rig.fs_hz)), np.log(min(2000.0, 0.35 * rig.fs_hz))))
    )


def _resonance(rng, rig, runs):
    damping = float(np.exp(rng.uniform(np.log(0.005), np.log(0.05))))
    drawn = _mode_frequency(rng, rig)
    stiffest = max(drawn, rng.uniform(0.5, 1) * min(2500.0, 0.4 * rig.fs_hz))
    return Proposal(
        lambda s: {"modes": (Mode(s, damping),)},
        min(150.0, 0.05 * rig.fs_hz),
        stiffest,
        drawn,
        lambda s: {"frequency_hz": (s, "Hz"), "damping_ratio": (damping, "1")},
    )


def _second_mode(rng, rig, runs):
    damping = float(np.exp(rng.uniform(np.log(0.005), np.log(0.05))))
    frequency = _mode_frequency(rng, rig)
    return Proposal(
        lambda s: {"modes": (Mode(frequency, damping, s),)},
        1e-4,
        0.5,
        0.1,
        lambda s: {"frequency_hz": (frequency, "Hz"), "damping_ratio": (damping, "1"), "share": (s, "1")},
    )


def _load_change(rng, rig, runs):
    return _one("load_ratio", "1", 1e-5, 0.4, 0.05, "stiffness_ratio")


def _backlash(rng, rig, runs):
    return Proposal(
        lambda s: {"half_gap_um": s},
        1e-5 * rig.range_um,
        0.02 * rig.range_um,
        0.003 * rig.range_um,
        lambda s: {"width_um": (2 * s, "um")},
    )


def _stiction(rng, rig, runs):
    share = rng.uniform(0.0, 0.6)
    return Proposal(
        lambda s: {"breakaway_um": s, "sliding_share": share},
        1e-5 * rig.range_um,
        0.02 * rig.range_um,
        0.003 * rig.range_um,
        lambda s: {"breakaway_um": (s, "um"), "sliding_um": (s * share, "um")},
    )


def _cross_coupling(rng, rig, runs):
    sign, gain = rng.choice([-1.0, 1.0]), rig.range_um / rig.span_v
    return Proposal(
        lambda s: {"coupling_um_per_v": sign * s * gain},
        1e-6,
        0.1,
        0.01,
        lambda s: {"coupling_um_per_v": (sign * s * gain, "um/V")},
    )


def _sensor_lag(rng, rig, runs):
    return _one("sensor_cutoff_hz", "Hz", 1.0, min(50e3, _fastest_hz(rig)), rig.fs_hz / 4, "cutoff_hz")


def _sensor_nonlinearity(rng, rig, runs):
    even, odd = rng.uniform(0.3, 1.0) * rng.choice([-1, 1]), rng.uniform(0.0, 1.0) * rng.choice([-1, 1])
    return Proposal(
        lambda s: {"a2_per_um": s * even / rig.range_um, "a3_per_um2": s * odd / rig.range_um**2},
        1e-5,
        0.1,
        0.005,
        lambda s: {
            "a2_per_um": (s * even / rig.range_um, "1/um"),
            "a3_per_um2": (s * odd / rig.range_um**2, "1/um^2"),
        },
    )


def _quantization(rng, rig, runs):
    return _one("lsb_um", "um", 1e-6, 0.02 * rig.range_um, 5 * rig.noise_um)


def _hum(rng, rig, runs):
    mains = float(rng.choice([50.0, 60.0]))
    shape = np.array([1.0, rng.uniform(0, 0.3), rng.uniform(0, 0.5)])
    return Proposal(
        lambda s: {"hum_um": tuple(s * shape), "mains_hz": mains},
        1e-6,
        0.01 * rig.range_um,
        3 * rig.noise_um,
        lambda s: {"amplitude_um": (s, "um"), "frequency_hz": (mains, "Hz")},
    )


def _thermal_drift(rng, rig, runs):
    tau = float(np.exp(rng.uniform(np.log(0.3), np.log(5.0)))) * runs[0].u.size / rig.fs_hz
    sign = rng.choice([-1.0, 1.0])
    return Proposal(
        lambda s: {"drift_um": sign * s, "drift_tau_s": tau},
        1e-5,
        0.1 * rig.range_um,
        10 * rig.noise_um,
        lambda s: {"amplitude_um": (sign * s, "um"), "tau_s": (tau, "s")},
    )


def _ageing(rng, rig, runs):
    if rng.random() < 0.5:
        return _one("ageing_per_s", "1/s", 1e-7, 0.2 * rig.fs_hz / runs[0].u.size, 1e-3, "loss_per_s")
    path = max(np.sum(np.abs(np.diff(run.u))) for run in runs) * rig.range_um / rig.span_v
    return _one("ageing_per_um", "1/um", 1e-9, 0.2 / path, 0.01 / path, "loss_per_um")


EFFECTS = {
    effect.name: effect
    for effect in (
        Effect("amplifier_lag", "amplifier", "v' = 2 pi f_c (u - v)", _amplifier_lag),
        Effect("slew_limit", "amplifier", "|v'| <= limit", _slew_limit),
        Effect("voltage_saturation", "amplifier", "v = min(u, upper)", _voltage_saturation),
        Effect("delay", "amplifier", "v(t) = u(t - delay), whole ticks beyond the hold", _delay),
        Effect("input_nonlinearity", "actuator", "v + c2 v^2 + c3 v^3 before the plays", _input_nonlinearity),
        Effect(
            "hysteresis_asymmetry",
            "actuator",
            "plays: rising branch at v - e span q(v), q = 4 x (1 - x), x = v/span",
            _hysteresis_asymmetry,
        ),
        Effect(
            "incongruent_loops",
            "actuator",
            "y + b (v/span - 1/2) (y - g v), g = range/span",
            _incongruent_loops,
        ),
        Effect("hysteresis_operator", "actuator", "y = (1 - s) PI + s other family", _hysteresis_operator),
        Effect(
            "rate_dependent_hysteresis",
            "actuator",
            "y + k ln(1 + |rate|/reference) (y - g v), rate through 2 ms, g = range/span",
            _rate_dependent_hysteresis,
        ),
        Effect("creep", "actuator", "y = x + sum g_i z_i, tau_i z_i' = x - z_i", _creep),
        Effect("leakage", "actuator", "y = x - z, z' = 2 pi f (x - z)", _leakage),
        Effect("resonance", "mechanics", "x'' + 2 zeta w0 x' + w0^2 x = w0^2 x_in", _resonance),
        Effect("second_mode", "mechanics", "y = (1 - share) x + share mode(x)", _second_mode),
        Effect(
            "load_change",
            "mechanics",
            "third recording: gain 1/(1 + ratio), f0 sqrt(1 + ratio)",
            _load_change,
        ),
        Effect("backlash", "mount", "play of a full width on the displacement", _backlash),
        Effect("stiction", "mount", "stuck until breakaway, then dragged sliding behind", _stiction),
        Effect("cross_coupling", "mechanics", "y + c aux", _cross_coupling),
        Effect("sensor_lag", "sensor", "y' = 2 pi f_c (x - y)", _sensor_lag),
        Effect("sensor_nonlinearity", "sensor", "x + a2 x^2 + a3 x^3", _sensor_nonlinearity),
        Effect("quantization", "edges", "round(y/lsb) lsb", _quantization),
        Effect("hum", "sensor", "mains line, second and third harmonic", _hum),
        Effect("thermal_drift", "any", "y + L (1 - exp(-t/tau)), L differs by run", _thermal_drift),
        Effect(
            "ageing", "actuator", "y (1 - loss), loss grows with time or travel in each recording", _ageing
        ),
    )
}
