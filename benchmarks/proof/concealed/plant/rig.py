"""The chain, from the controller's command to the number that its converter reads."""

import math
from dataclasses import dataclass, field

import numpy as np
from concealed.plant import blocks
from concealed.plant.hysteresis import Hysteresis
from concealed.plant.physics import Array, Physics

RATE_FILTER_S = 2e-3


@dataclass(frozen=True)
class Rig:
    """A plain plant and how it is sampled.

    `timing` says which command the reading of tick k responds to: "end_of_hold", u(k) after its whole hold;
    "before_write", u(k-1), since the controller reads before it writes.
    """

    hysteresis: Hysteresis
    other_hysteresis: Hysteresis
    fs_hz: float
    oversampling: int
    lower_v: float
    span_v: float
    range_um: float
    noise_um: float
    noise_colour: str
    timing: str
    seed: int
    _known: dict[tuple[object, ...], Array] = field(default_factory=dict, compare=False, repr=False)


@dataclass(frozen=True)
class Run:
    """One recording to be made: commands, second axis (or none), its number, and whether a load is on."""

    u: Array  # shape: (samples,), V
    aux: Array | None  # shape: (samples,), V
    number: int
    loaded: bool = False
    history: int = 0  # leading samples of `u` that are played and not recorded


def simulate(rig: Rig, physics: Physics, run: Run, noise_um: Array | None = None) -> Array:
    """Return the readings, µm, of one run from the de-energised state; noise is added only if given.

    A history is played first and is not read.
    """
    fine = rig.oversampling
    dt = 1 / (rig.fs_hz * fine)
    x = _actuator(rig, physics, run, dt)
    x = _mechanics(rig, physics, run, x, dt)
    readings = _read(rig, x)[run.history :]
    time = np.arange(readings.size) / rig.fs_hz
    readings = readings + _autonomous(rig, physics, run, time)
    for outside in physics.outside:
        if outside.place == "sensor":
            readings = outside.act(readings, 1 / rig.fs_hz, rig.seed + run.number)
    if noise_um is not None:
        readings = readings + noise_um
    if physics.lsb_um > 0:
        readings = np.round(readings / physics.lsb_um) * physics.lsb_um
    return readings


def _actuator(rig: Rig, physics: Physics, run: Run, dt: float) -> Array:
    dac = tuple(o for o in physics.outside if o.place == "converter")
    key = (
        run.number,
        len(run.u),
        physics.delay_s,
        physics.upper_v,
        physics.lower_v,
        physics.amplifier_cutoff_hz,
        physics.slew_v_per_s,
        physics.c2_per_v,
        physics.c3_per_v2,
        physics.envelope,
        physics.incongruence,
        physics.other_family_share,
        physics.rate_widening,
        dac,
        float(run.u.sum()),
    )
    if key not in rig._known:
        if len(rig._known) > 12:
            rig._known.clear()
        rig._known[key] = _hysteretic(rig, physics, run, dt, dac)
    x = rig._known[key]
    if physics.leakage_hz:
        x = blocks.high_pass(x, physics.leakage_hz, dt)
    if physics.creep:
        x = blocks.creep(x, np.array(physics.creep.gains), np.array(physics.creep.taus_s), dt)
    return x


def _hysteretic(rig, physics, run, dt, dac):
    u = run.u
    for outside in dac:
        u = outside.act(u, 1 / rig.fs_hz, rig.seed + run.number)
    v = np.repeat(u, rig.oversampling)
    late = round(physics.delay_s / dt)
    if late:
        v = np.concatenate([np.zeros(late), v[:-late]])
    v = np.clip(v, physics.lower_v, physics.upper_v)
    if math.isfinite(physics.slew_v_per_s):
        v = blocks.slew(v, physics.slew_v_per_s, dt)
    if math.isfinite(physics.amplifier_cutoff_hz):
        v = blocks.lag(v, physics.amplifier_cutoff_hz, dt)
    bent = v + physics.c2_per_v * v**2 + physics.c3_per_v2 * v**3
    x = rig.hysteresis.respond(bent, physics.envelope) if physics.envelope else rig.hysteresis.respond(bent)
    if physics.other_family_share:
        other = rig.other_hysteresis.respond(bent)
        x = (1 - physics.other_family_share) * x + physics.other_family_share * other
    if physics.incongruence or physics.rate_widening:
        loop = x - rig.range_um / rig.span_v * v
        growth = physics.incongruence * (v / rig.span_v - 0.5)
        if physics.rate_widening:
            smooth = blocks.lag(v, 1 / (2 * math.pi * RATE_FILTER_S), dt)
            rate = np.abs(v - smooth) / RATE_FILTER_S
            growth = growth + physics.rate_widening * np.log1p(rate / physics.rate_reference_v_per_s)
        x = x + growth * loop
    return x


def _mechanics(rig, physics, run, x, dt):
    ratio = physics.load_ratio if run.loaded else 0.0
    x = x / (1 + ratio)
    if physics.modes:
        rigid = 1 - sum(mode.share for mode in physics.modes)
        moved = rigid * x
        for mode in physics.modes:
            frequency = mode.frequency_hz * math.sqrt(1 + ratio)
            moved = moved + mode.share * blocks.mode(x, frequency, mode.damping_ratio, dt)
        x = moved
    for outside in physics.outside:
        if outside.place == "mechanics":
            x = outside.act(x, dt, rig.seed + run.number)
    if physics.ageing_per_s or physics.ageing_per_um:
        worn = physics.ageing_per_s * dt * np.arange(x.size)
        if physics.ageing_per_um:
            worn = worn + physics.ageing_per_um * blocks.travel(x)
        x = x * (1 - worn)
    if physics.half_gap_um:
        x = blocks.backlash(x, physics.half_gap_um)
    if physics.breakaway_um:
        sliding = physics.sliding_share * physics.breakaway_um
        x = blocks.stick_slip(x, physics.breakaway_um, sliding, 1e-9 * rig.range_um)
    if physics.coupling_um_per_v and run.aux is not None:
        x = x + physics.coupling_um_per_v * np.repeat(run.aux, rig.oversampling)
    if math.isfinite(physics.sensor_cutoff_hz):
        x = blocks.lag(x, physics.sensor_cutoff_hz, dt)
    if physics.a2_per_um or physics.a3_per_um2:
        x = x + physics.a2_per_um * x**2 + physics.a3_per_um2 * x**3
    return x


def _read(rig: Rig, x: Array) -> Array:
    ends = x[rig.oversampling - 1 :: rig.oversampling]
    return ends if rig.timing == "end_of_hold" else np.concatenate([[0.0], ends[:-1]])


def _autonomous(rig, physics, run, time):
    """Displacements that no command causes: warming, which differs from run to run, and mains hum."""
    rng = np.random.default_rng([rig.seed, 77, run.number])
    y = np.zeros(time.size)
    if physics.drift_um:
        y += physics.drift_um * rng.uniform(0.6, 1.4) * (1 - np.exp(-time / physics.drift_tau_s))
    for order, amplitude in enumerate(physics.hum_um, 1):
        phase = rng.uniform(0, 2 * math.pi)
        y += amplitude * np.sin(2 * math.pi * order * physics.mains_hz * time + phase)
    return y
