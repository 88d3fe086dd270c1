"""The commands, V, of three recordings that a user would make, and of the judge's own fourth."""

import math
from dataclasses import dataclass

import numpy as np
from concealed.plant.physics import Array


@dataclass(frozen=True)
class Reach:
    """Limits of the commands, V, and their sampling."""

    lower_v: float
    upper_v: float
    fs_hz: float
    samples: int


def draw_recordings(kind: str, rng: np.random.Generator, reach: Reach) -> list[Array]:
    """Draw three commands of `reach.samples` each, de-energised at the first sample.

    "rich" is the discriminating set (hold, odd multisine at two amplitudes, stairs up and down, triangles at
    three rates and amplitudes with minor loops); "paper" a 5 Hz sine, a sum of sines and triangles; "poor"
    one slow sine at three amplitudes.
    """
    if kind == "rich":
        parts = [_multisines(rng, reach), _stairs(rng, reach), _triangles(rng, reach)]
    elif kind == "paper":
        parts = [_sine(reach, 5.0, 0.9), _sum_of_sines(rng, reach), _triangles(rng, reach)]
    else:
        slow = max(0.5, 6 * reach.fs_hz / reach.samples)
        parts = [_sine(reach, slow, a) for a in (0.95, 0.6, 0.3)]
    return [_fit(part, reach.samples) for part in parts]


def draw_fourth(kind: str, rng: np.random.Generator, reach: Reach) -> Array:
    """Draw one more command for cases with four recordings, of another kind than the first three."""
    parts = {
        "rich": lambda: _sum_of_sines(rng, reach),
        "paper": lambda: _stairs(rng, reach),
        "poor": lambda: _sine(reach, max(1.0, 12 * reach.fs_hz / reach.samples), 0.95),
    }
    return _fit(parts[kind](), reach.samples)


def draw_heldout(rng: np.random.Generator, reach: Reach) -> Array:
    """The judge's recording: a third of another multisine, decaying triangles, stairs and random ramps."""
    n = reach.samples
    middle = 0.5 * (reach.lower_v + reach.upper_v)
    half = 0.46 * (reach.upper_v - reach.lower_v)
    sine = middle + half * rng.uniform(0.75, 1) * _odd_multisine(rng, n // 3, reach.fs_hz, periods=1)
    cycles = 7
    phase = np.arange(n // 3) / (n // 3) * cycles
    triangle = 2 * np.abs(2 * (phase % 1) - 1) - 1
    decaying = middle - half * triangle * (1 - 0.9 * phase / cycles)
    points = np.concatenate([[decaying[-1]], rng.uniform(reach.lower_v, reach.upper_v, 9) * 0.95, [0.0]])
    times = np.linspace(0, 1, points.size)
    ramps = np.interp(np.linspace(0, 1, n // 6), times, points)
    levels = rng.uniform(max(reach.lower_v, 0.0), 0.95 * reach.upper_v, 6)
    parts = [np.zeros(n // 100), sine, decaying, ramps]
    stairs = np.repeat(levels, (n - sum(part.size for part in parts)) // 6 + 1)
    return _fit(_joined([*parts, stairs], reach), n)


def draw_aux(rng: np.random.Generator, reach: Reach) -> Array:
    """Draw the voltage of an independent second axis: a slow sum of sines, V."""
    t = np.arange(reach.samples) / reach.fs_hz
    frequencies = np.exp(rng.uniform(np.log(3 / t[-1]), np.log(reach.fs_hz / 60), 12))
    y = sum(np.sin(2 * math.pi * f * t + rng.uniform(0, 2 * math.pi)) / math.sqrt(f) for f in frequencies)
    return 0.5 * reach.upper_v * y / np.max(np.abs(y)) * np.minimum(1, t * reach.fs_hz / 200)


def _fit(u: Array, samples: int) -> Array:
    u = np.asarray(u, dtype=float)[:samples]
    return np.concatenate([u, np.full(samples - u.size, u[-1])])


def _joined(parts: list[Array], reach: Reach) -> Array:
    """Join the parts, with half-cosine bridges where their ends do not meet."""
    out = [parts[0]]
    count = max(reach.samples // 60, 8)
    bridge = 0.5 - 0.5 * np.cos(np.linspace(0, math.pi, count))
    for part in parts[1:]:
        last, first = out[-1][-1], part[0]
        if abs(first - last) > 0.02 * (reach.upper_v - reach.lower_v):
            out.append(last + (first - last) * bridge)
        out.append(part)
    return np.concatenate(out)


def _odd_multisine(rng: np.random.Generator, period: int, fs_hz: float, periods: int) -> Array:
    """Odd lines to fs/20, one in four left out, none within 1 % of the mains; peak one."""
    top = max(period // 20, 8)
    lines = np.arange(1, top, 2)
    keep = np.ones(lines.size, dtype=bool)
    for start in range(0, lines.size - 3, 4):
        keep[start + rng.integers(4)] = False
    hertz = lines * fs_hz / period
    for mains in (50.0, 60.0):
        keep &= np.abs(hertz - mains) > 0.01 * mains
    lines = lines[keep]
    amplitude = 1 / np.maximum(1.0, lines / (period / 1000))
    best = None
    for _ in range(12):  # take the phases with the lowest crest factor of a dozen draws
        spectrum = np.zeros(period // 2 + 1, dtype=complex)
        spectrum[lines] = amplitude * np.exp(1j * rng.uniform(0, 2 * math.pi, lines.size))
        y = np.fft.irfft(spectrum, period)
        y /= np.max(np.abs(y))
        if best is None or y.std() > best.std():
            best = y
    return np.tile(best, periods)


def _multisines(rng: np.random.Generator, reach: Reach) -> Array:
    n = reach.samples
    period = int(0.19 * n)
    middle = 0.5 * (reach.lower_v + reach.upper_v)
    half = 0.48 * (reach.upper_v - reach.lower_v)
    wave = _odd_multisine(rng, period, reach.fs_hz, periods=2)
    small = rng.uniform(0.25, 0.5)
    return _joined([np.zeros(int(0.15 * n)), middle + half * wave, middle + small * half * wave], reach)


def _stairs(rng: np.random.Generator, reach: Reach) -> Array:
    n = reach.samples
    steps = int(rng.integers(6, 9))
    top = rng.uniform(0.93, 0.99) * reach.upper_v
    up = np.linspace(0, top, steps + 1)[1:]
    down = up[::-1][1:]
    bottom = [0.0] if reach.lower_v == 0 else [0.0, 0.9 * reach.lower_v]
    levels = np.concatenate([up, down, bottom])
    start = n // 50
    hold = (n - start) // levels.size
    edge_s = 0.0 if rng.random() < 0.5 else float(np.exp(rng.uniform(np.log(1e-3), np.log(2e-2))))
    edge = np.linspace(0, 1, max(int(edge_s * reach.fs_hz), 1) + 1)[1:]  # some amplifiers need gradual steps
    parts, last = [np.zeros(start)], 0.0
    for level in levels:
        parts += [last + (level - last) * edge, np.full(hold - edge.size, level)]
        last = level
    return np.concatenate(parts)


def _triangles(rng: np.random.Generator, reach: Reach) -> Array:
    n = reach.samples
    top = rng.uniform(0.93, 0.98) * reach.upper_v
    scale = n / 33_000
    parts = [np.zeros(int(200 * scale)), _major_with_minor_loops(rng, top, int(9500 * scale))]
    for amplitude in (1.0, 0.6, 0.3):
        for period, cycles in ((2400, 2), (600, 3), (150, 6)):
            leg = np.linspace(0, 1, max(int(period * scale) // 2, 4), endpoint=False)
            parts.append(np.tile(amplitude * top * np.concatenate([leg, 1 - leg]), cycles))
    return np.concatenate(parts)


def _major_with_minor_loops(rng: np.random.Generator, top: float, samples: int) -> Array:
    low, high = rng.uniform(0.2, 0.4), rng.uniform(0.6, 0.8)
    dip = rng.uniform(0.08, 0.18)
    corners = [0.0]
    for bias in (low, high):
        corners += [bias, bias - dip] * 2
    corners.append(1.0)
    for bias in (high, low):
        corners += [bias, bias + dip] * 2
    corners.append(0.0)
    legs = np.abs(np.diff(corners))
    times = np.concatenate([[0], np.cumsum(legs) / legs.sum()])
    return top * np.interp(np.linspace(0, 1, samples), times, corners)


def _sine(reach: Reach, frequency_hz: float, amplitude: float) -> Array:
    t = np.arange(reach.samples) / reach.fs_hz
    return amplitude * reach.upper_v * (0.5 - 0.5 * np.cos(2 * math.pi * frequency_hz * t))


def _sum_of_sines(rng: np.random.Generator, reach: Reach) -> Array:
    t = np.arange(reach.samples) / reach.fs_hz
    y = sum(
        np.sin(2 * math.pi * f * t + rng.uniform(0, 2 * math.pi)) / f**0.5 for f in (1.0, 2.3, 5.1, 9.7, 16.9)
    )
    wave = reach.upper_v * (0.5 + 0.45 * y / np.max(np.abs(y)))
    return _joined([np.zeros(reach.samples // 50), wave], reach)
