"""Physics outside the list. `near` holds the listed effects truly in it: naming those is not wrong."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from concealed.plant import blocks
from concealed.plant.effects import Proposal, _mode_frequency
from concealed.plant.physics import Outside
from concealed.plant.rig import Rig


@dataclass(frozen=True)
class Unknown:
    """A name for the judge's table, what it does, how it is drawn, and the listed names that it contains."""

    name: str
    equation: str
    place: str
    propose: Callable[[np.random.Generator, Rig], tuple[Callable, float, float, float]]
    near: frozenset[str] = frozenset()

    def proposal(self, rng: np.random.Generator, rig: Rig) -> Proposal:
        """Draw the effect with everything except its strength."""
        act, low, high, start = self.propose(rng, rig)
        return Proposal(
            lambda s: {"outside": (Outside(self.name, self.place, lambda x, dt, seed: act(x, dt, seed, s)),)},
            low,
            high,
            start,
            lambda s: {"strength": (s, "1")},
        )


def _gain_walk(rng, rig):
    def act(y, dt, seed, s):
        steps = np.random.default_rng([seed, 1]).standard_normal(y.size)
        walk = np.cumsum(steps) / math.sqrt(y.size)
        return y * (1 + s * walk)

    return act, 1e-6, 0.2, 0.01


def _jitter(rng, rig):
    def act(y, dt, seed, s):
        shift = s * np.random.default_rng([seed, 2]).standard_normal(y.size)
        ticks = np.arange(y.size)
        return np.interp(ticks + shift, ticks, y)

    return act, 1e-5, 1.0, 0.05


def _aliased_tone(rng, rig):
    alias = rng.uniform(0.05, 0.45) * rig.fs_hz
    wander = rng.uniform(0.002, 0.01) * rig.fs_hz

    def act(y, dt, seed, s):
        g = np.random.default_rng([seed, 3])
        slow = np.cumsum(g.standard_normal(y.size)) / math.sqrt(y.size)
        phase = 2 * math.pi * np.cumsum(alias + wander * slow) * dt
        return y + s * rig.range_um * np.sin(phase + g.uniform(0, 6.28))

    return act, 1e-7, 0.02, 1e-3


def _glitches(rng, rig):
    often = rng.uniform(5, 40) / 33_000

    def act(y, dt, seed, s):
        g = np.random.default_rng([seed, 4])
        jumps = np.zeros(y.size)
        for start in np.flatnonzero(g.random(y.size) < often):
            jumps[start : start + g.integers(5, 300)] += g.choice([-1, 1]) * g.uniform(0.5, 1.5)
        return y + s * rig.range_um * jumps

    return act, 1e-7, 0.1, 1e-3


def _duffing(rng, rig):
    frequency, damping = _mode_frequency(rng, rig), rng.uniform(0.02, 0.08)
    reference = 0.02 * rig.range_um
    cubic = rng.uniform(0.3, 1.0) / reference**2

    def act(x, dt, seed, s):
        return (1 - s) * x + s * blocks.mode(x, frequency, damping, dt, cubic, 0.0)

    return act, 1e-4, 1.0, 0.2


def _moving_mode(rng, rig):
    frequency, damping = _mode_frequency(rng, rig), rng.uniform(0.005, 0.03)
    soft = rng.uniform(0.1, 0.3) * rng.choice([-1, 1]) / rig.range_um

    def act(x, dt, seed, s):
        return (1 - s) * x + s * blocks.mode(x, frequency, damping, dt, 0.0, soft)

    return act, 1e-4, 1.0, 0.2


def _guide_friction(rng, rig):
    tau, coulomb = rng.uniform(2, 20) / rig.fs_hz, rng.uniform(0.002, 0.01) * rig.range_um

    def act(x, dt, seed, s):
        return (1 - s) * x + s * blocks.friction(x, coulomb, tau, dt)

    return act, 1e-6, 1.0, 0.05


def _dead_steps(rng, rig):
    def act(u, dt, seed, s):
        return blocks.dead_steps(u, s * rig.span_v)

    return act, 1e-6, 0.05, 1e-3


def _repeated_samples(rng, rig):
    length = int(rng.integers(2, 30))

    def act(y, dt, seed, s):
        g = np.random.default_rng([seed, 6])
        out = y.copy()
        for start in np.flatnonzero(g.random(y.size) < s / length):
            out[start : start + length] = out[start]
        return out

    return act, 1e-5, 0.3, 0.01


def _sensor_memory(rng, rig):
    threshold = rng.uniform(0.02, 0.1) * rig.range_um

    def act(y, dt, seed, s):
        relayed = blocks.backlash(y, threshold)
        return y + s * (relayed - y) * np.abs(relayed) / rig.range_um

    return act, 1e-5, 1.0, 0.05


def _regime_switch(rng, rig):
    def act(y, dt, seed, s):
        g = np.random.default_rng([seed, 8])
        gain, state = np.empty(y.size), 0.0
        flips = g.random(y.size) < 6 / y.size
        for t in range(y.size):
            state = 1.0 - state if flips[t] else state
            gain[t] = state
        return y * (1 + s * gain)

    return act, 1e-6, 0.2, 0.01


UNKNOWNS = {
    unknown.name: unknown
    for unknown in (
        Unknown(
            "gain_random_walk",
            "y (1 + s W(t)), W a random walk of unit end",
            "sensor",
            _gain_walk,
            frozenset({"ageing", "gain_modulation"}),
        ),
        Unknown("timebase_jitter", "read at k + s N(0, 1) ticks", "sensor", _jitter),
        Unknown(
            "aliased_tone", "+ s range sin(phase), wandering line off the mains", "sensor", _aliased_tone
        ),
        Unknown("sensor_glitches", "+- s range for 5 to 300 ticks, now and then", "sensor", _glitches),
        Unknown(
            "duffing_mode",
            "hardening mode, share s",
            "mechanics",
            _duffing,
            frozenset({"resonance", "second_mode"}),
        ),
        Unknown(
            "position_dependent_mode",
            "mode whose frequency follows the position, share s",
            "mechanics",
            _moving_mode,
            frozenset({"resonance", "second_mode"}),
        ),
        Unknown(
            "guide_friction",
            "a share s drags: tau y' = pull beyond a breakaway",
            "mechanics",
            _guide_friction,
            frozenset({"backlash", "stiction", "amplifier_lag", "sensor_lag"}),
        ),
        Unknown(
            "dead_steps",
            "converter ignores changes below s span",
            "converter",
            _dead_steps,
            frozenset({"stiction", "backlash", "quantization"}),
        ),
        Unknown(
            "repeated_samples",
            "a share s of samples repeats the one before",
            "sensor",
            _repeated_samples,
            frozenset({"dropouts"}),
        ),
        Unknown(
            "sensor_memory",
            "play in the sensor that grows with |y|",
            "sensor",
            _sensor_memory,
            frozenset({"incongruent_loops", "hysteresis_asymmetry", "hysteresis_operator"}),
        ),
        Unknown(
            "regime_switch",
            "gain flips between 1 and 1 + s about six times",
            "sensor",
            _regime_switch,
            frozenset({"gain_modulation"}),
        ),
    )
}
