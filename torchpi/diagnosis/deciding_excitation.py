"""Excitations that each make some effects differ, within what the recordings have already covered.

Every function takes the limits and a seed and returns the voltage (time,), V, which begins and ends inside
the limits' range. The constants in capitals describe in words what is played, and about how long it takes.
Below 50 samples per second all times are stretched, so that every hold contains samples.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from torchpi.excitation.limits import (
    FADE,
    DriveLimits,
    largest_rate_v_s,
    multisine_swing,
    staircase,
    straight_lines,
    vibration,
)

PERIOD_S, PERIODS = 2.0, 3
STATIC_HZ = 50.0  # up to here the lines come from the hysteresis and its curvature, not from the dynamics


@dataclass(frozen=True)
class Movement:
    """A movement of the voltage, not yet adapted to any limits."""

    words: str
    seconds: float
    """Approximate duration."""
    make: Callable[[DriveLimits, int], np.ndarray]


def multisines(limits: DriveLimits, seed: int) -> np.ndarray:
    """The odd multisine over the whole band, at two amplitudes."""
    return _two_multisines(limits, seed, (0.4, 0.13))


def slow_multisines(limits: DriveLimits, seed: int) -> np.ndarray:
    """The odd multisine at low frequencies only, at two amplitudes, the larger over the whole range."""
    low = replace(limits, high_hz=min(limits.high_hz, STATIC_HZ / stretch(limits.sample_rate_hz)))
    return _two_multisines(low, seed, (1.0, 0.3))


def sines_of_three_amplitudes(limits: DriveLimits, seed: int) -> np.ndarray:
    """One frequency at three amplitudes, the largest as fast as the recordings were."""
    fastest_v_s = (1 - FADE) * limits.max_rate_v_s
    frequency_hz = min(fastest_v_s / (math.pi * limits.span_v), limits.high_hz)
    samples = math.ceil(limits.sample_rate_hz / frequency_hz)
    sine = limits.span_v / 2 * np.sin(2 * np.pi * np.arange(samples) / samples)
    periods = max(10, math.ceil(2 * stretch(limits.sample_rate_hz) * frequency_hz))
    return np.concatenate([vibration(limits, share * sine, periods) for share in (0.25, 0.5, 1.0)])


def long_stairs(limits: DriveLimits, seed: int) -> np.ndarray:
    """The same levels on the way up and on the way down, each held for a long time."""
    fractions = (1 / 3, 2 / 3, 1.0, 2 / 3, 1 / 3, 0.0)
    return staircase(limits, fractions, [15 * stretch(limits.sample_rate_hz)] * len(fractions))


def long_hold(limits: DriveLimits, seed: int) -> np.ndarray:
    """One step, held for three decades of time, and the way back."""
    return staircase(
        limits, (0.9, 0.0), [100 * stretch(limits.sample_rate_hz), 30 * stretch(limits.sample_rate_hz)]
    )


def growing_triangles(limits: DriveLimits, seed: int) -> np.ndarray:
    """Slow triangles that grow from small to the whole range, two of each size."""
    corners = [level for height in np.linspace(0.1, 1.0, 10) for level in (height, 0.0, height, 0.0)]
    return _slow_lines(limits, corners, 1.0)


def small_reversals(limits: DriveLimits, seed: int) -> np.ndarray:
    """Slow reversals of growing size about three biases."""
    corners = []
    for bias in (0.25, 0.5, 0.75):
        corners += [bias]
        for size in np.geomspace(0.005, 0.2, 8):
            corners += [bias + size, bias - size] * 2
    return _slow_lines(limits, corners, 0.4)


def loops_at_biases(limits: DriveLimits, seed: int) -> np.ndarray:
    """Minor loops of one size at five biases, going up and coming down."""
    up = [level for bias in np.linspace(0.1, 0.9, 5) for level in (bias + 0.1, bias - 0.1) * 3]
    return _slow_lines(limits, [*up, 1.0, *up[::-1]], 0.5)


def triangles_of_three_rates(limits: DriveLimits, seed: int) -> np.ndarray:
    """The same triangle at increasing rates, up to the rate of the recordings."""
    fastest = limits.max_rate_v_s / limits.span_v
    corners, seconds = [0.0], [0.0]
    for rate in np.geomspace(max(fastest / 100, 0.2 / stretch(limits.sample_rate_hz)), fastest, 3):
        for level in (1.0, 0.0) * 3:
            corners.append(level)
            seconds.append(seconds[-1] + 1 / rate)
    return straight_lines(limits, corners, seconds)


def twice_with_a_rest(limits: DriveLimits, seed: int) -> np.ndarray:
    """The same full triangles, many of them, before and after a long rest."""
    rate = min(limits.max_rate_v_s / limits.span_v, 4 / stretch(limits.sample_rate_hz))
    travel = straight_lines(limits, [0.0, 1.0] * 20 + [0.0], (np.arange(41) / rate).tolist())
    rest = np.full(math.ceil(30 * stretch(limits.sample_rate_hz) * limits.sample_rate_hz), travel[-1])
    return np.concatenate((travel, rest, travel))


def rest_and_creeping_ramp(limits: DriveLimits, seed: int) -> np.ndarray:
    """Two rests, and between them a ramp so slow that single steps of a converter show."""
    hold = np.full(
        math.ceil(10 * stretch(limits.sample_rate_hz) * limits.sample_rate_hz), limits.level_v(0.5)
    )
    ramp = straight_lines(
        limits,
        [0.5, 0.51, 0.5],
        [0.0, 10 * stretch(limits.sample_rate_hz), 20 * stretch(limits.sample_rate_hz)],
    )
    return np.concatenate((hold, ramp, hold))


def stretch(fs_hz: float) -> float:
    """Factor by which all times are longer than needed at a usual sample rate."""
    return max(1.0, 50 / fs_hz)


def _two_multisines(limits: DriveLimits, seed: int, shares: tuple[float, float]) -> np.ndarray:
    # A smaller share of the range leaves more of the permitted rate to the high frequencies.
    faster = replace(limits, max_rate_v_s=limits.max_rate_v_s / shares[0])
    swing = multisine_swing(faster, PERIOD_S * stretch(limits.sample_rate_hz), seed)
    bearable = min(1.0, (1 - FADE) * faster.max_rate_v_s / largest_rate_v_s(limits, swing))
    return np.concatenate([vibration(limits, bearable * share * swing, PERIODS) for share in shares])


def _slow_lines(limits: DriveLimits, corners: list[float], ranges_per_s: float) -> np.ndarray:
    corners = [0.0, *corners, 0.0]
    seconds = np.cumsum([0.0, *np.abs(np.diff(corners))]) * stretch(limits.sample_rate_hz) / ranges_per_s
    return straight_lines(limits, corners, seconds.tolist())


MULTISINES = Movement("an odd multisine over the whole band, at two amplitudes", 15, multisines)
SLOW_MULTISINES = Movement("a low-frequency odd multisine, at two amplitudes", 15, slow_multisines)
SINES = Movement("a sine of one frequency at three amplitudes", 10, sines_of_three_amplitudes)
LONG_STAIRS = Movement("a staircase up and down through the same levels, with long holds", 95, long_stairs)
LONG_HOLD = Movement("one step, held over three decades of time, and the step back", 130, long_hold)
GROWING = Movement("slow triangles of growing amplitude, up to the whole range", 25, growing_triangles)
SMALL_REVERSALS = Movement("slow reversals of growing size about three bias voltages", 30, small_reversals)
LOOPS = Movement("minor loops of one size at five bias voltages", 30, loops_at_biases)
RATES = Movement("the same triangle at three rates", 35, triangles_of_three_rates)
TWICE = Movement("the same triangles before and after a long rest", 60, twice_with_a_rest)
REST = Movement("two rests with a very slow ramp between them", 40, rest_and_creeping_ramp)
