"""What people drive stages with: good sets and poor ones, unipolar or bipolar, with rests or without."""

import math
from collections.abc import Callable

import numpy as np
from concealed.plant.physics import Array
from scipy.signal import lfilter

Wave = Callable[[np.random.Generator, int], Array]


def _multisine(rng: np.random.Generator, n: int) -> Array:
    """Random phases, pink above a hundredth of the band; two periods."""
    period = n // 2
    lines = np.arange(1, max(int(period * rng.uniform(0.02, 0.2)), 9), rng.choice([1, 2]))
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    phases = rng.uniform(0, 2 * math.pi, lines.size)
    spectrum[lines] = np.exp(1j * phases) / np.sqrt(np.maximum(lines, lines[-1] / 20))
    return np.resize(np.fft.irfft(spectrum, period), n)


def _chirp(rng: np.random.Generator, n: int) -> Array:
    t, top = np.linspace(0, 1, n), rng.uniform(0.02, 0.1) * n
    return -np.cos(2 * math.pi * (2 * t + (top - 2) * t * t / 2)) * (1 - 0.5 * t)


def _prbs(rng: np.random.Generator, n: int) -> Array:
    hold = max(n // int(rng.integers(80, 400)), 3)
    return (
        np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]
        * np.repeat(rng.uniform(0.3, 1, 5), n // 5 + 1)[:n]
    )


def _steps(rng: np.random.Generator, n: int) -> Array:
    count = int(rng.integers(12, 40))
    return np.repeat(rng.uniform(-1, 1, count), n // count + 1)[:n]


def _coloured(rng: np.random.Generator, n: int) -> Array:
    pole = 1 - 1 / (n * rng.uniform(0.001, 0.01) + 2)
    return lfilter([1], [1, -pole], rng.standard_normal(n))


def _decaying(rng: np.random.Generator, n: int) -> Array:
    t = np.linspace(0, 1, n)
    return -np.cos(2 * math.pi * rng.integers(6, 16) * t) * (1 - 0.9 * t)


def _ramps(rng: np.random.Generator, n: int) -> Array:
    corners = np.concatenate([[-1, 1, -1], rng.uniform(-1, 1, int(rng.integers(8, 30)))])
    return np.interp(np.linspace(0, corners.size - 1, n), np.arange(corners.size), corners)


def _stairs(rng: np.random.Generator, n: int) -> Array:
    levels = np.linspace(-1, 1, int(rng.integers(5, 9)))
    levels = np.concatenate([levels, levels[-2::-1]])
    return np.repeat(levels, n // levels.size + 1)[:n]


def _raster(rng: np.random.Generator, n: int) -> Array:
    t = np.linspace(0, 1, n)
    lines = rng.integers(10, 40)
    return 0.4 * (np.abs(4 * ((lines * t) % 1) - 2) - 1) + 0.6 * (2 * t - 1)


def _sine(rng: np.random.Generator, n: int) -> Array:
    return -np.cos(2 * math.pi * rng.integers(3, 30) * np.linspace(0, 1, n))


def _triangle(rng: np.random.Generator, n: int) -> Array:
    return -(np.abs(4 * ((rng.integers(2, 12) * np.linspace(0, 1, n)) % 1) - 2) - 1)


BROAD: tuple[Wave, ...] = (_multisine, _chirp, _prbs, _steps, _coloured)
LOOPS: tuple[Wave, ...] = (_decaying, _ramps, _stairs, _raster)
POOR: tuple[Wave, ...] = (_sine, _triangle)


def draw_waves(rng: np.random.Generator, recordings: int, samples: int) -> tuple[list[Wave], bool]:
    """The recordings' waves, and whether they are adequate: loops, a band of frequencies, 4,000 samples."""
    if rng.random() < 0.2:
        return [POOR[rng.integers(len(POOR))] for _ in range(recordings)], False
    kinds = [BROAD, LOOPS]
    rng.shuffle(kinds)
    waves = [kinds[k % 2][rng.integers(len(kinds[k % 2]))] for k in range(recordings)]
    both = any(w in BROAD for w in waves) and any(w in LOOPS for w in waves)
    # Stairs and steps of one recording hold both: jumps and the levels between them.
    return waves, (both or waves[0] in (_steps, _stairs, _prbs)) and samples * recordings >= 4000


def command(
    wave: Wave, rng: np.random.Generator, n: int, lower_v: float, upper_v: float, rests: bool
) -> Array:
    """The wave between the limits, from 0 V, after a rest and with one at its end where there are rests."""
    rest = int(rng.uniform(0.05, 0.12) * n) if rests else 0
    bridge = max(n // 50, 4)
    y = wave(rng, n - 2 * rest - bridge)
    y = (y - y.min()) / max(np.ptp(y), 1e-12)
    low, high = sorted(rng.uniform([0.0, 0.85], [0.1, 1.0]))
    u = lower_v + (upper_v - lower_v) * (low + (high - low) * y)
    ramp = u[0] * (0.5 - 0.5 * np.cos(np.linspace(0, math.pi, bridge)))
    return np.round(np.concatenate([np.zeros(rest), ramp, u, np.full(rest, u[-1])]), 6)


def heldout(rng: np.random.Generator, n: int, lower_v: float, upper_v: float) -> Array:
    """The judge's recording: a band of frequencies, loops and steps in turn, de-energised at first."""
    waves = (_multisine, _decaying, _steps)
    return np.concatenate([command(wave, rng, n // 3, lower_v, upper_v, False) for wave in waves])
