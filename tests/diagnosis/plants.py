"""Small simulated rigs for the tests. They share no code with the stage, so no equation tests itself."""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.signal import lfilter

from torchpi.recordings.recording import Recording

FS_HZ = 2_000.0
NOISE_UM = 0.004
FINER = 16
"""Solver steps per sample."""

Signal = np.ndarray
Step = Callable[[Signal, float], Signal]


def hysteresis(v: Signal, plays: int = 60, reach_v: float = 10.0) -> Signal:
    """Prandtl–Ishlinskii operator with random thresholds and a loop of about ten per cent."""
    rng = np.random.default_rng(11)
    thresholds = np.append(rng.uniform(0.02, 0.95, plays) * reach_v, 0.0)
    weights = np.append(rng.uniform(0.2, 1.0, plays) * 0.45 / (0.6 * plays), 0.55)
    y, state = np.zeros(len(v)), np.zeros(len(thresholds))
    for k, one in enumerate(v):
        state = np.maximum(one - thresholds, np.minimum(one + thresholds, state))
        y[k] = weights @ state
    return y


def multisine(samples: int, fs_hz: float = FS_HZ, high_hz: float = 200.0, seed: int = 0) -> Signal:
    """Return a random-phase multisine, 0 to 10 V from 0 V, whose amplitudes fall with frequency."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) / fs_hz
    lines = np.unique(np.maximum(np.round(np.geomspace(1.0, high_hz, 60) * samples / fs_hz), 1))
    f = lines * fs_hz / samples
    x = sum(np.cos(2 * np.pi * (one * t + rng.uniform())) / np.sqrt(one) for one in f)
    return 10 * (x - np.min(x)) / np.ptp(x) * np.minimum(1, t / 0.05)


def triangles(samples: int, rate_hz: float = 3.0, fs_hz: float = FS_HZ) -> Signal:
    """Return triangles from 0 V to 10 V, every second one smaller."""
    t = np.arange(samples) / fs_hz
    size = np.where(np.floor(t * rate_hz) % 2 == 0, 10.0, 4.0)
    return size * (1 - np.abs((2 * rate_hz * t) % 2 - 1))


def stairs(samples: int, steps: int = 8) -> Signal:
    """Return a staircase up and down whose levels are held."""
    levels = np.concatenate([np.linspace(0, 9, steps // 2 + 1), np.linspace(9, 0, steps // 2 + 1)[1:]])
    return np.repeat(levels, -(-samples // len(levels)))[:samples]


def lag(x: Signal, fs_hz: float, cutoff_hz: float) -> Signal:
    """First-order lag of a held voltage, by Euler's method with a hundred steps per sample."""
    a = (1 - 2 * np.pi * cutoff_hz / fs_hz / 100) ** 100
    return lfilter([1 - a], [1, -a], x)


def resonance(x: Signal, fs_hz: float, f0_hz: float, damping: float) -> Signal:
    """Mode of unit static gain, by the trapezoidal rule in finer steps with a linearly interpolated input."""
    samples = len(x)
    fine = np.interp(np.arange(1, samples * FINER + 1) / FINER, np.arange(samples + 1), np.append(0.0, x))
    w, c = 2 * np.pi * f0_hz, 2 * fs_hz * FINER
    b = np.array([w * w, 2 * w * w, w * w])
    a = np.array(
        [c * c + 2 * damping * w * c + w * w, 2 * (w * w - c * c), c * c - 2 * damping * w * c + w * w]
    )
    return lfilter(b, a, fine)[FINER - 1 :: FINER]


def creep(x: Signal, fs_hz: float, per_decade: float) -> Signal:
    """y = x + γ log₁₀ t, as five relaxations a decade, 3 ms to 100 s; those under 0.1 s vanish statically."""
    y = x.copy()
    for tau in np.geomspace(3e-3, 100.0, 23):
        a = np.exp(-1 / (fs_hz * tau))
        relaxed = lfilter([0.5 * (1 - a), 0.5 * (1 - a)], [1, -a], x)
        y += 0.2 * per_decade * (relaxed - x * (tau < 0.1))
    return y


def record(
    u: Signal,
    *,
    before: Step = lambda v, fs_hz: v,
    after: Step = lambda x, fs_hz: x,
    noise_um: float = NOISE_UM,
    fs_hz: float = FS_HZ,
    seed: int = 0,
    name: str = "a",
    aux: Mapping[str, Signal] | None = None,
) -> Recording:
    """Record the rig with a step before its hysteresis, one after it, and white noise."""
    y = after(hysteresis(before(u, fs_hz)), fs_hz)
    y = y + noise_um * np.random.default_rng(1000 + seed).standard_normal(len(u))
    return Recording(name, np.arange(len(u)) / fs_hz, u, y, fs_hz, dict(aux or {}))


def pair(samples: int = 4000, **rig: object) -> list[Recording]:
    """Record a multisine and triangles on one rig."""
    return [
        record(multisine(samples), name="multisine", seed=1, **rig),
        record(triangles(samples), name="triangles", seed=2, **rig),
    ]
