"""Sample rate from time stamps, or the row where the sampling is not uniform.

A stamp is printed with a finite number of digits, or stored as float32, so it deviates from the true instant
by up to half its resolution. That can exceed a sample period (`%.6g` after 100 s at 10 kHz prints ten equal
stamps in a row). Stamps are accepted if a uniform grid explains each of them within its own resolution.
"""

from dataclasses import dataclass

import numpy as np

STEP_TOLERANCE = 0.01  # of the sample period: 1 µs at 10 kHz, a nanometre at 1 mm/s
DRIFT_TOLERANCE = 0.5  # of the sample period: every sample is nearest to its own grid point


@dataclass(frozen=True)
class Grid:
    """Sample rate from the stamps, and the first sample that does not lie on the grid (None: all do)."""

    fs_hz: float
    odd_sample: int | None
    """The sample whose step from the previous one differs, or that lies furthest off the grid."""
    step_s: float
    """The step that leads to that sample."""
    median_step_s: float
    rate_uncertainty: float
    """Relative, from the resolution of the stamps alone."""


def uniform_grid(t: np.ndarray) -> Grid:
    """Return the grid of the stamps `t` (time,), s, at least two of them and finite.

    The rate is the roundest number within the resolution of the stamps: 10000.0 for steps of 0.1 ms.
    """
    steps = np.diff(t)
    period = float(t[-1] - t[0]) / (len(t) - 1)
    median = float(np.median(steps))
    if period <= 0:
        odd_sample = int(np.argmax(steps <= 0)) + 1
        return Grid(np.nan, odd_sample, float(steps[odd_sample - 1]), median, 0.0)
    resolution = print_resolution(t)
    floor = float(4 * np.spacing(np.abs(t).max()))  # rounding of the subtraction, at full precision
    # Equal steps were not rounded: a grid of 0.1 ms has 4 decimals, however many are printed.
    rounded = float(np.ptp(steps)) > floor
    uncertainty = float(resolution[0] + resolution[-1]) / 2 / abs(period * len(steps)) if rounded else 0.0

    def verdict(odd_sample: int | None) -> Grid:
        step = float(steps[max(0, odd_sample - 1)]) if odd_sample is not None else median
        if odd_sample is not None and median > 0:
            return Grid(1 / median, odd_sample, step, median, uncertainty)
        return Grid(round_rate(period, uncertainty), odd_sample, step, median, uncertainty)

    odd = np.abs(steps - median) > STEP_TOLERANCE * abs(median) + floor
    off_grid = _off_grid(t, resolution + STEP_TOLERANCE * period)
    if not odd.any():
        # Even if all steps are near the median, deviations may add up when the rate wanders.
        worst = int(np.argmax(off_grid))
        return verdict(worst if off_grid[worst] > DRIFT_TOLERANCE * period + resolution[worst] else None)
    if _rounding_explains(odd, off_grid, resolution, period):
        return verdict(None)
    beyond_rounding = np.abs(steps - median) > np.maximum(resolution[1:], resolution[:-1]) + floor
    return verdict(int(np.argmax(odd & beyond_rounding if np.any(odd & beyond_rounding) else odd)) + 1)


def print_resolution(t: np.ndarray) -> np.ndarray:
    """Return the step between neighbouring printable (or storable) numbers at each stamp (time,), s.

    The coarser of two formats that fit all stamps: fixed decimals (`%.6f`), significant digits (`%.6g`).
    """
    spacing = np.spacing(np.abs(t))
    if np.array_equal(t, t.astype(np.float32)):
        spacing = np.spacing(np.abs(t).astype(np.float32)).astype(np.float64)
    slack = 4 * np.spacing(np.abs(t))
    decimals = next((d for d in range(16) if np.all(np.abs(t - np.round(t, d)) <= slack)), None)
    fixed = 10.0**-decimals if decimals is not None else 0.0
    magnitude = np.floor(np.log10(np.where(t == 0, np.abs(t).max(), np.abs(t)) * (1 + 1e-12)))
    for digits in range(1, 16):
        unit = 10.0 ** (magnitude - digits + 1)
        if np.all(np.abs(t - np.round(t / unit) * unit) <= slack):
            floating = np.where(t == 0, 0.0, unit)
            return np.asarray(np.maximum(np.maximum(fixed, floating), spacing))
    return np.asarray(np.maximum(fixed, spacing))


def round_rate(period_s: float, uncertainty: float) -> float:
    """Return the rate with fewest digits that agrees with the period, or the rate of a period with fewest."""
    band = max(uncertainty, 1e-9)
    for digits in range(1, 16):
        rate = float(f"{1 / period_s:.{digits - 1}e}")
        if abs(rate * period_s - 1) <= band:
            return rate
        period = float(f"{period_s:.{digits - 1}e}")
        if abs(period / period_s - 1) <= band:
            return 1 / period
    return 1 / period_s


def _off_grid(t: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    """Return the distance of each stamp from the best straight line, in which finer stamps weigh more."""
    weight = 1 / tolerance**2
    weight /= weight.sum()
    index = np.arange(len(t), dtype=np.float64)
    index -= weight @ index
    centred = t - weight @ t
    slope = (weight * index) @ centred / ((weight * index) @ index)
    return np.asarray(np.abs(centred - slope * index))


def _rounding_explains(odd: np.ndarray, off_grid: np.ndarray, resolution: np.ndarray, period: float) -> bool:
    """Whether rounding explains the odd steps: it causes many, all near the line; a lost sample, one or two.

    A lost row in otherwise exact stamps could also be a slightly lower rate, rounded. It is treated as lost.
    """
    alone = odd.sum() <= 2 and not np.any(resolution[1:][odd] > period * (1 + STEP_TOLERANCE))
    # 1.2 because the least-squares line lies slightly off the middle of the rounding intervals.
    return not alone and bool(np.all(off_grid <= 0.5 * 1.2 * resolution + STEP_TOLERANCE * period))
