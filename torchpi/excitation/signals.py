"""Voltages for recording a stage, and trajectories to follow.

Every function takes the duration (s) and the sample rate (Hz) first and returns `t, x`, both (time,) float64:
an excitation in V, a trajectory in µm. If a signal does not begin at 0 V, `ramp_in_s` adds an eased approach
from 0 V before it, so that a de-energised stage does not receive a step; the ramp adds to the duration.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from inspect import signature
from typing import Any

import numpy as np

from torchpi.errors import ConfigError

MOST_SAMPLES = 20_000_000  # half an hour at 10 kHz, 160 MB a signal
MOST_MINOR_LOOPS = 1000  # at each bias

Samples = tuple[np.ndarray, np.ndarray]  # t (time,), s; and the signal (time,), V or µm


def sine_5hz(
    duration_s: float = 1.0, fs_hz: float = 10_000.0, low_v: float = 0.0, high_v: float = 10.0
) -> Samples:
    """The slow record of stage 1 (eq. 10): a 5 Hz sine, 0…10 V, from its lowest point.

    It is slow enough to show hysteresis without rate dependence; weights and polynomial are fitted to it.
    """
    t = _times(duration_s, fs_hz)
    return t, _between(_sine(5, t), low_v, high_v)


def paper_multisine(duration_s: float = 1.0, fs_hz: float = 10_000.0) -> Samples:
    """Eq. 13, V: u = 5 + sin(40πt − π/2) + 2 sin(100πt − π/2) + 2 sin(160πt − π/2); 20, 50, 80 Hz.

    0…9.632 V, period 0.1 s, at most 1,740 V/s, from 0 V at rest. Used to fit the rate-dependent weights
    (eq. 11); the paper asks for 5,000 points or more.
    """
    t = _times(duration_s, fs_hz)
    return t, 5 + _sine(20, t) + 2 * _sine(50, t) + 2 * _sine(80, t)


def multisine(
    duration_s: float = 8.0,
    fs_hz: float = 10_000.0,
    low_v: float = 0.0,
    high_v: float = 10.0,
    low_hz: float = 1.0,
    high_hz: float = 200.0,
    periods: int = 2,
    odd_lines: bool = False,
    detection_lines: bool = False,
    mains_hz: Sequence[float] = (50.0, 60.0),
    rms_v: float | None = None,
    seed: int = 0,
    ramp_in_s: float = 0.1,
    corner_hz: float | None = None,
) -> Samples:
    """Random-phase multisine with a flat spectrum: covers a band, with many reversals, in one record.

    With `odd_lines` and `detection_lines` (only odd multiples of the period's frequency, and one random line
    in four left out), nonlinear distortion appears at lines that were not excited: at even lines if it is
    asymmetric, at odd lines if it is symmetric. Differences between periods are noise, drift and hum.

    Args:
        duration_s: duration of all periods together, without the ramp.
        fs_hz: sample rate.
        low_v, high_v: range, filled unless `rms_v` is given.
        low_hz, high_hz: band of the lines.
        periods: repetitions of the same period. The lines are `periods / duration_s` apart.
        odd_lines: only odd multiples.
        detection_lines: one line in four left out.
        mains_hz: no line lies on these frequencies or their multiples.
        rms_v: rms about the middle of the range, instead of filling the range.
        seed: seed of the phases and of the lines left out.
        ramp_in_s: time of an eased approach before the first period, which remains complete.
        corner_hz: lines above it fall as 1/f, so that all of them move the stage at one rate.

    Raises:
        ConfigError: no line lies in the band, or the rms leaves the range.
    """
    _check_band(low_hz, high_hz, fs_hz)
    if periods < 1:
        raise ConfigError(f"multisine: periods is {periods}, expected 1 or more")
    _check_range(low_v, high_v)
    random = np.random.default_rng(seed)
    samples = len(_times(duration_s / periods, fs_hz))
    lines = _lines(samples, fs_hz, low_hz, high_hz, odd_lines, mains_hz)
    if detection_lines:
        left_out = [group[random.integers(len(group))] for group in _groups(lines, 4) if len(group) == 4]
        lines = np.setdiff1d(lines, left_out)
    period = _random_phases(lines, samples, random, _falling(lines, fs_hz / samples, corner_hz))
    if rms_v is None:
        period = _between(period, low_v, high_v)
    else:
        period = (low_v + high_v) / 2 + rms_v * period / np.sqrt(np.mean(period**2))
        if period.min() < low_v or period.max() > high_v:
            raise ConfigError(
                f"multisine: rms_v {rms_v:g} V needs {period.min():.3g}…{period.max():.3g} V, "
                f"expected {low_v:g}…{high_v:g} V; use a smaller rms_v or a wider range"
            )
    return _ramped_in(np.tile(period, periods), period, fs_hz, ramp_in_s)


def triangles(
    duration_s: float = 30.0,
    fs_hz: float = 10_000.0,
    low_v: float = 0.0,
    high_v: float = 10.0,
    amplitudes: Sequence[float] = (1.0, 0.6, 0.3),
    rates: Sequence[float] = (1.0, 3.0, 10.0),
    minor_biases: Sequence[float] = (0.3, 0.7),
    minor_amplitude: float = 0.2,
    minor_loops: int = 2,
) -> Samples:
    """Triangles of several amplitudes and rates, each followed by minor loops at several biases.

    Constant rates separate rate dependence from path dependence, and straight lines show every curvature of
    the stage's response. Minor loops show whether loops at different biases are congruent.

    Args:
        duration_s: total duration; the rates are scaled to it.
        fs_hz: sample rate.
        low_v, high_v: range. The first ramp begins at 0 V if the range does.
        amplitudes: heights above low_v, as fractions of the range.
        rates: slopes relative to each other.
        minor_biases: middles of the minor loops, as fractions of the range.
        minor_amplitude: their peak-to-peak amplitude, as a fraction of the range.
        minor_loops: number of loops at each bias.
    """
    _check_range(low_v, high_v)
    levels, seconds = triangle_corners(amplitudes, rates, minor_biases, minor_amplitude, minor_loops)
    t = _times(duration_s, fs_hz)
    return t, low_v + (high_v - low_v) * np.interp(t / duration_s * seconds[-1], seconds, levels)


def triangle_corners(
    amplitudes: Sequence[float],
    rates: Sequence[float],
    minor_biases: Sequence[float],
    minor_amplitude: float,
    minor_loops: int,
) -> tuple[list[float], list[float]]:
    """Return where `triangles` turn, as fractions of the range, and when, s for rates in ranges per second.

    Raises:
        ConfigError: levels outside the range, or none.
    """
    if minor_loops > MOST_MINOR_LOOPS:
        raise ConfigError(f"triangles: found {minor_loops} minor_loops, expected at most {MOST_MINOR_LOOPS}")
    levels, seconds = [0.0], [0.0]

    def go(level: float, rate: float) -> None:
        seconds.append(seconds[-1] + abs(level - levels[-1]) / rate)
        levels.append(level)

    for rate in rates:
        for amplitude in amplitudes:
            go(amplitude, rate)
            go(0.0, rate)
        for bias in minor_biases:
            for _ in range(minor_loops):
                go(bias + minor_amplitude / 2, rate)
                go(bias - minor_amplitude / 2, rate)
        go(0.0, rate)
    if seconds[-1] == 0 or min(levels) < 0 or max(levels) > 1:
        raise ConfigError(
            f"triangles: levels run from {min(levels):g} to {max(levels):g} of the range, "
            "expected levels within 0 to 1 that "
            f"differ; change amplitudes, minor_biases or minor_amplitude"
        )
    return levels, seconds


def stairs(
    duration_s: float = 20.0,
    fs_hz: float = 10_000.0,
    low_v: float = 0.0,
    high_v: float = 10.0,
    steps: int = 5,
    rise_s: float = 0.0,
) -> Samples:
    """A staircase up and down again, resting on every level for the same time.

    The rests show creep and distinguish it from drift: creep follows the direction of the last step, while
    drift depends on time alone. The steps show ringing and delay, unless `rise_s` eases them.

    Args:
        duration_s: total duration; each of the 2·steps + 1 levels takes an equal part of it.
        fs_hz: sample rate.
        low_v, high_v: range.
        steps: number of steps from low_v to high_v.
        rise_s: time of each eased step; 0 jumps.
    """
    _check_range(low_v, high_v)
    t = _times(duration_s, fs_hz)
    if not 1 <= steps <= len(t):
        raise ConfigError(f"stairs: found {steps} steps, expected 1 to {len(t)}, at most one per sample")
    rest = duration_s / (2 * steps + 1)
    if not 0 <= rise_s <= rest:
        raise ConfigError(f"stairs: rise_s is {rise_s:g}, expected 0 to {rest:g} s, the time on each level")
    up = np.arange(1, steps + 1) / steps
    levels = np.concatenate(([0.0], up, up[-2::-1], [0.0]))
    at = np.minimum((t / rest + 1e-9).astype(int), 2 * steps)
    before = levels[np.maximum(at - 1, 0)]
    risen = ease((t - at * rest) / rise_s) if rise_s > 0 else np.ones_like(t)
    return t, low_v + (high_v - low_v) * (before + (levels[at] - before) * risen)


def hold(
    duration_s: float = 5.0, fs_hz: float = 10_000.0, level_v: float = 5.0, ramp_in_s: float = 0.05
) -> Samples:
    """A rest at one voltage after an eased approach from 0 V; shows creep, drift, hum and sensor noise."""
    samples = len(_times(duration_s, fs_hz))
    return _ramped_in(np.full(samples, float(level_v)), np.full(samples, float(level_v)), fs_hz, ramp_in_s)


def sine_trajectory(duration_s: float = 1.0, fs_hz: float = 10_000.0, frequency_hz: float = 5.0) -> Samples:
    """Eq. 9, µm: y_d = 5.5 + 4.5 sin(2πft − π/2). The paper takes f = 5, 10, 50 and 100 Hz."""
    t = _times(duration_s, fs_hz)
    return t, 5.5 + 4.5 * _sine(frequency_hz, t)


def slow_trajectory(duration_s: float = 2.0, fs_hz: float = 10_000.0) -> Samples:
    """Eq. 15, µm: 4 + sin(2πt − π/2) + sin(10πt − π/2) + sin(18πt − π/2); 1…7 µm, at most 94.2 µm/s."""
    t = _times(duration_s, fs_hz)
    return t, 4 + _sine(1, t) + _sine(5, t) + _sine(9, t)


def fast_trajectory(duration_s: float = 1.0, fs_hz: float = 10_000.0) -> Samples:
    """Eq. 16, µm: 4.5 + 1.5 sin(64πt − π/2) + sin(80πt − π/2) + sin(100πt − π/2); 1…7.826 µm, 831.5 µm/s."""
    t = _times(duration_s, fs_hz)
    return t, 4.5 + 1.5 * _sine(32, t) + _sine(40, t) + _sine(50, t)


def random_trajectory(
    duration_s: float = 2.0,
    fs_hz: float = 10_000.0,
    low_um: float = 1.0,
    high_um: float = 7.0,
    low_hz: float = 1.0,
    high_hz: float = 50.0,
    seed: int = 0,
    ease_s: float = 0.05,
) -> Samples:
    """A trajectory that nothing was tuned for, µm: random phases over a band, filling low_um…high_um.

    It begins at rest at low_um, as eq. 15 and 16 do, and reaches its full amplitude after `ease_s`.
    """
    _check_band(low_hz, high_hz, fs_hz)
    t = _times(duration_s, fs_hz)
    lines = _lines(len(t), fs_hz, low_hz, high_hz, odd=False, mains_hz=())
    y = _between(_random_phases(lines, len(t), np.random.default_rng(seed)), low_um, high_um)
    return t, low_um + (y - low_um) * ease(t / ease_s if ease_s > 0 else np.ones_like(t))


def ease(s: np.ndarray) -> np.ndarray:
    """Rise from 0 to 1 over s = 0…1, with no jump in position, rate (at most 15/8) or acceleration."""
    s = np.clip(s, 0, 1)
    return np.asarray(s**3 * (10 - 15 * s + 6 * s**2))


EXCITATIONS: dict[str, Callable[..., Samples]] = {
    "sine_5hz": sine_5hz,
    "paper_multisine": paper_multisine,
    "multisine": multisine,
    "triangles": triangles,
    "stairs": stairs,
    "hold": hold,
}
"""Excitations by the name that a command takes; V."""

TRAJECTORIES: dict[str, Callable[..., Samples]] = {
    "sine": sine_trajectory,
    "slow": slow_trajectory,
    "fast": fast_trajectory,
    "random": random_trajectory,
}
"""Trajectories by the name that a command takes; µm."""


def make_excitation(
    name: str,
    fs_hz: float,
    duration_s: float | None = None,
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
) -> Samples:
    """Make an excitation by its name, as commands and configs do.

    Args:
        name: one of EXCITATIONS.
        fs_hz: sample rate.
        duration_s: duration, s; None takes the excitation's default.
        seed: seed of random phases; excitations without random phases ignore it.
        options: any other arguments of the excitation.

    Raises:
        ConfigError: an unknown name or option (the message suggests the nearest), or an unsuitable value.

    Example:
        >>> from torchpi.excitation import make_excitation
        >>> t, u = make_excitation("sine_5hz", fs_hz=10_000.0, duration_s=0.4)
        >>> (len(u), float(u.min()), float(u.max()))
        (4000, 0.0, 10.0)
    """
    if name not in EXCITATIONS:
        raise ConfigError(
            f"no excitation '{name}'{_perhaps(name, EXCITATIONS)}; available: {', '.join(EXCITATIONS)}"
        )
    make, options = EXCITATIONS[name], dict(options or {})
    known = [key for key in signature(make).parameters if key not in ("duration_s", "fs_hz")]
    for key in options:
        if key not in known:
            takes = ", ".join(known) or "none"
            raise ConfigError(
                f"excitation {name}: no option '{key}'{_perhaps(key, known)}; its options are: {takes}"
            )
    if "seed" in known:
        options.setdefault("seed", seed)
    if duration_s is not None:
        options["duration_s"] = duration_s
    try:
        return make(fs_hz=fs_hz, **options)
    except (TypeError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        values = ", ".join(f"{key}={value!r}" for key, value in options.items())
        raise ConfigError(f"excitation {name}: cannot use {values} ({error}); correct the options") from None


def _perhaps(name: str, known: Iterable[str]) -> str:
    guess = get_close_matches(name, list(known), n=1)
    return f", perhaps '{guess[0]}'" if guess else ""


def _times(duration_s: float, fs_hz: float) -> np.ndarray:
    if not (np.isfinite(fs_hz) and fs_hz > 0):
        raise ConfigError(f"fs_hz is {fs_hz:g}, expected a sample rate over 0 Hz")
    samples = samples_in(duration_s, fs_hz, "duration_s") if np.isfinite(duration_s) else 0
    if samples < 2:
        raise ConfigError(f"duration_s is {duration_s:g}, expected at least two samples, {2 / fs_hz:g} s")
    return np.arange(samples) / fs_hz


def samples_in(seconds: float, fs_hz: float, name: str) -> int:
    """Return the number of samples of a signal of this length.

    Raises:
        ConfigError: More than MOST_SAMPLES, which may exceed memory; the message begins with `name`.
    """
    if not abs(seconds) * fs_hz <= MOST_SAMPLES:
        raise ConfigError(
            f"{name}: found {seconds:g} s of signal at {fs_hz:g} Hz, expected at most {MOST_SAMPLES} samples"
        )
    return round(seconds * fs_hz)


def _sine(frequency_hz: float, t: np.ndarray) -> np.ndarray:
    """Return sin(2πft − π/2), which starts at −1, at rest, at t = 0."""
    return np.asarray(np.sin(2 * np.pi * frequency_hz * t - np.pi / 2))


def _between(x: np.ndarray, low: float, high: float) -> np.ndarray:
    _check_range(low, high)
    return np.asarray(np.clip(low + (high - low) * (x - x.min()) / np.ptp(x), low, high))


def _lines(
    samples: int, fs_hz: float, low_hz: float, high_hz: float, odd: bool, mains_hz: Sequence[float]
) -> np.ndarray:
    """Return the multiples of fs/samples inside the band, except those on the mains."""
    spacing = fs_hz / samples
    lines = np.arange(max(1, int(np.ceil(low_hz / spacing - 1e-9))), int(high_hz / spacing + 1e-9) + 1)
    if odd:
        lines = lines[lines % 2 == 1]
    for mains in mains_hz:
        multiple = np.maximum(1, np.round(lines * spacing / mains))
        lines = lines[np.abs(lines * spacing - multiple * mains) > 0.5 * spacing]
    if not len(lines):
        raise ConfigError(
            f"no line of the multisine falls into {low_hz:g}…{high_hz:g} Hz: the lines are "
            f"{spacing:.3g} Hz apart; "
            f"use a longer duration, fewer periods or a wider band"
        )
    return lines


def _groups(lines: np.ndarray, size: int) -> list[np.ndarray]:
    return [lines[k : k + size] for k in range(0, len(lines), size)]


def _falling(lines: np.ndarray, spacing_hz: float, corner_hz: float | None) -> np.ndarray:
    """Return relative amplitudes: 1 up to the corner, falling as 1/f beyond."""
    if corner_hz is None:
        return np.ones(len(lines))
    return np.asarray(np.minimum(1, corner_hz / (lines * spacing_hz)))


def _random_phases(
    lines: np.ndarray, samples: int, random: np.random.Generator, amplitudes: np.ndarray | float = 1.0
) -> np.ndarray:
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[lines] = amplitudes * np.exp(2j * np.pi * random.random(len(lines)))
    return np.asarray(np.fft.irfft(spectrum, n=samples))


def _ramped_in(x: np.ndarray, period: np.ndarray, fs_hz: float, ramp_in_s: float) -> Samples:
    """Prepend the end of x's own period, eased up from 0 V, so that x begins without a step or kink."""
    if not (np.isfinite(ramp_in_s) and ramp_in_s >= 0):
        raise ConfigError(f"ramp_in_s is {ramp_in_s:g}, expected 0 or more")
    ramp = samples_in(ramp_in_s, fs_hz, "ramp_in_s")
    before = period[np.arange(-ramp, 0) % len(period)] * ease(np.arange(ramp) / max(1, ramp))
    x = np.concatenate((before, x))
    return np.arange(len(x)) / fs_hz, x


def _check_range(low: float, high: float) -> None:
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise ConfigError(f"the range is {low:g}…{high:g}, expected two different limits, the lower first")


def _check_band(low_hz: float, high_hz: float, fs_hz: float) -> None:
    if not 0 <= low_hz < high_hz < fs_hz / 2:
        raise ConfigError(
            f"the band is {low_hz:g}…{high_hz:g} Hz at {fs_hz:g} Hz, "
            f"expected the lower frequency first, both below {fs_hz / 2:g} Hz"
        )
