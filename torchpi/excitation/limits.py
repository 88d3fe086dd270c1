"""Drive limits of a stage and its amplifier, and movements of the voltage within these limits.

Movements are arrays (time,), V, at the limits' sample rate. Steps and corners are eased, so that little of
their spectrum lies beyond `high_hz`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchpi.errors import ConfigError
from torchpi.excitation.signals import Samples, ease, multisine, samples_in

REST_S = 0.1  # at 0 V before the voltage moves; sets the recording's zero
STEEPEST_EASE = 15 / 8  # largest rate of `ease`, relative to distance / time
FADE = 0.1  # share of the largest rate reserved for fading a vibration in and out
LONGEST_S = 30.0  # duration of a movement
CORNERS = 40  # number of corner frequencies tried for a multisine, from the flattest spectrum down


@dataclass(frozen=True)
class DriveLimits:
    """Range, rate and band of the voltage.

    Raises:
        ConfigError: limits exclude each other; the message names one, its value and the value expected.

    Example:
        >>> from torchpi.excitation import DriveLimits
        >>> DriveLimits(max_voltage_v=8.0, max_rate_v_s=500.0).span_v
        8.0
    """

    min_voltage_v: float = 0.0
    """0 or less: a de-energised stage is at 0 V."""
    max_voltage_v: float = 10.0
    max_rate_v_s: float = 2000.0
    sample_rate_hz: float = 10_000.0
    high_hz: float = 200.0
    """The highest frequency to drive."""

    def __post_init__(self) -> None:
        for name in ("max_rate_v_s", "sample_rate_hz", "high_hz"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ConfigError(f"{name} is {getattr(self, name):g}, expected more than 0")
        low, high = self.min_voltage_v, self.max_voltage_v
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ConfigError(f"the voltage runs from {low:g} to {high:g} V, expected the lower limit first")
        if not low <= 0 <= high:
            name, expected = ("min_voltage_v", "0 V or less") if low > 0 else ("max_voltage_v", "0 V or more")
            raise ConfigError(
                f"{name} is {low if low > 0 else high:g} V, expected {expected}: "
                "a recording starts de-energised at 0 V"
            )
        # The set has several movements through the range, so each must fit into memory.
        samples_in(LONGEST_S, self.sample_rate_hz, "sample_rate_hz")
        samples_in(STEEPEST_EASE * (high - low) / self.max_rate_v_s, self.sample_rate_hz, "max_rate_v_s")
        samples_in(2 / self.high_hz, self.sample_rate_hz, "high_hz")
        if self.sample_rate_hz < 4 * self.high_hz:
            raise ConfigError(
                f"sample_rate_hz is {self.sample_rate_hz:g} Hz, expected {4 * self.high_hz:g} Hz or more, "
                f"four times high_hz; sample faster, or lower high_hz to {self.sample_rate_hz / 4:g} Hz"
            )

    @property
    def span_v(self) -> float:
        return self.max_voltage_v - self.min_voltage_v

    @property
    def middle_v(self) -> float:
        return (self.max_voltage_v + self.min_voltage_v) / 2

    def level_v(self, fraction: float) -> float:
        """Return the voltage at this fraction of the range."""
        return self.min_voltage_v + fraction * self.span_v


def recorded(limits: DriveLimits, u: np.ndarray) -> Samples:
    """Return times from 0 on and the movement `u`, with a rest at 0 V before and a return to 0 V after it."""
    rest = np.zeros(math.ceil(REST_S * limits.sample_rate_hz))
    u = np.concatenate((rest, moved(limits, 0.0, u[0]), u, moved(limits, u[-1], 0.0), [0.0]))
    return np.arange(len(u)) / limits.sample_rate_hz, u


def moved(limits: DriveLimits, from_v: float, to_v: float) -> np.ndarray:
    """Return an eased step, without its last sample, as fast as rate and band allow."""
    seconds = max(STEEPEST_EASE * abs(to_v - from_v) / limits.max_rate_v_s, 2 / limits.high_hz)
    samples = math.ceil(seconds * limits.sample_rate_hz)
    return np.asarray(from_v + (to_v - from_v) * ease(np.arange(samples) / samples))


def staircase(limits: DriveLimits, fractions: Sequence[float], holds_s: Sequence[float]) -> np.ndarray:
    """Return steps from 0 V through levels of the range; each level is held for its time after its step."""
    parts, before = [], 0.0
    for fraction, hold_s in zip(fractions, holds_s, strict=True):
        level = limits.level_v(fraction)
        parts += [
            moved(limits, before, level),
            np.full(math.ceil(hold_s * limits.sample_rate_hz), level),
        ]
        before = level
    return np.concatenate(parts)


def straight_lines(limits: DriveLimits, fractions: Sequence[float], seconds: Sequence[float]) -> np.ndarray:
    """Return straight lines between corners (fractions of the range at these times), with rounded corners."""
    from scipy.ndimage import uniform_filter1d  # here, as most uses of excitations do without

    t = np.arange(math.ceil(seconds[-1] * limits.sample_rate_hz) + 1) / limits.sample_rate_hz
    u = limits.level_v(0.0) + limits.span_v * np.interp(t, seconds, fractions)
    window = math.ceil(limits.sample_rate_hz / limits.high_hz / 2)
    for _ in range(2):
        u = uniform_filter1d(u, window, mode="nearest")
    return np.clip(u, limits.min_voltage_v, limits.max_voltage_v)


def vibration(limits: DriveLimits, swing: np.ndarray, periods: int) -> np.ndarray:
    """Return whole periods of a swing (one period, V about the middle), faded in before and out after them.

    The swing itself must leave the share FADE of the largest rate unused.
    """
    seconds = max(STEEPEST_EASE * np.abs(swing).max() / (FADE * limits.max_rate_v_s), 2 / limits.high_hz)
    samples = math.ceil(seconds * limits.sample_rate_hz)
    risen = ease(np.arange(samples) / samples)
    before = swing[np.arange(-samples, 0) % len(swing)] * risen
    after = swing[np.arange(samples) % len(swing)] * (1 - risen)
    return np.asarray(limits.middle_v + np.concatenate((before, np.tile(swing, periods), after)))


def multisine_swing(limits: DriveLimits, period_s: float, seed: int) -> np.ndarray:
    """Return one period of the odd random-phase multisine that fills the range, V about its middle.

    One odd line in four is left out, and no line lies on the mains. The spectrum is flat up to a corner and
    falls as 1/f beyond; the corner is as high as the rate allows. Even with the lowest corner the rate may
    be too large, so check it with `largest_rate_v_s`.
    """
    samples = round(period_s * limits.sample_rate_hz)
    for corner_hz in np.geomspace(limits.high_hz, 1 / period_s, CORNERS):
        _, u = multisine(
            samples / limits.sample_rate_hz,
            limits.sample_rate_hz,
            limits.min_voltage_v,
            limits.max_voltage_v,
            0.0,
            limits.high_hz,
            periods=1,
            odd_lines=True,
            detection_lines=True,
            seed=seed,
            ramp_in_s=0.0,
            corner_hz=corner_hz,
        )
        swing = u - limits.middle_v
        if largest_rate_v_s(limits, swing) <= (1 - FADE) * limits.max_rate_v_s:
            break
    return np.asarray(swing)


def largest_rate_v_s(limits: DriveLimits, swing: np.ndarray) -> float:
    """Return the largest rate between samples of one period, including the step to the next period."""
    return float(np.abs(np.diff(swing, append=swing[0])).max() * limits.sample_rate_hz)
