"""Properties of recorded signals: noise, single wrong readings, and which of two signals leads."""

import numpy as np

MOTION_FACTOR = 4.0
"""A wrong reading stands apart by more than this many usual steps; a triangle's corner by one."""
FALSE_ALARM = 1e-3
"""Probability that noise alone produces a dropout anywhere in a record."""
DENSER, OFTENER, SPREAD = 3.0, 5.0, 0.5
"""Density at a value that a stage passes often, in mean densities of readings; how many times as often as
others a suspect value recurs; least share of the input's scatter that the input has at its readings."""
STEP, RINGING, LATEST = 0.02, 2, 5
"""Change of the input between samples that counts as a step, as a share of its range; number of samples
before a step in which filters ring; number of samples within which a stage follows its input."""
LEAST_LEAD = 0.02  # about one degree of a sine
ROUNDING = 1e-9
"""Differences below this share of a signal's largest value are rounding."""


def noise_estimate(y: np.ndarray) -> float:
    """Return the standard deviation of the random change from sample to sample, in the signal's unit.

    It is estimated from the median of |y(k) − cubic through its four neighbours|. White noise σ gives this
    difference a standard deviation of √(35/18)·σ; slow motion contributes nothing. For fast motion the
    estimate is an upper bound; if a converter rounds all noise away, it is zero.

    Args:
        y: (time,).
    """
    if len(y) < 5:
        return 0.0
    residual = y[2:-2] - (4 * (y[1:-3] + y[3:-1]) - y[:-4] - y[4:]) / 6
    return float(robust_sd(residual) / np.sqrt(35 / 18))


def robust_sd(x: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Return the standard deviation of Gaussian values about 0, robust against a few outliers, in their unit.

    From the median of their absolute values (Hampel, *J. American Statistical Association* 69, 1974).

    Args:
        x: (…, time).
        axis: Axis of the median; None takes all values.
    """
    sd: np.ndarray = 1.4826 * np.median(np.abs(x), axis=axis)
    return sd


def dropouts(y: np.ndarray, u: np.ndarray | None = None, sensor_step: float | None = None) -> np.ndarray:
    """Indices of isolated wrong readings, such as one zero among readings of 5 µm.

    A reading is wrong if it lies beyond both its neighbours, on the same side, by more than noise and motion
    explain: the lesser of |y(k) − y(k−1)| and |y(k) − y(k+1)| exceeds

    - √1.5·σ·Φ⁻¹(1 − α/2n), which white noise of σ (`noise_estimate`) exceeds anywhere in n samples with
      probability at most α = 0.001: the mean of the two differences has variance 1.5 σ²;
    - 4 times the median of the eight nearest other steps; a corner of a triangle reaches one such step;
    - 3 steps of the sensor, because rounding causes isolated changes of one step;
    - 4 times what the input, in this sample or one of the five before, lies beyond both its own neighbours,
      times the ratio of both ranges: a fast excitation moves the stage there and back within a sample.

    In fast motion a wrong zero may lie between its neighbours, so readings of a value that recurs too often
    count as wrong too; see `repeated_value`.

    The first and last sample, which have only one neighbour, are never returned, nor are two wrong readings
    in a row. Readings beside steps of the input are left out if they cluster there: an overshoot of a sample
    or two is the response of the stage, or of a zero-phase filter.

    Args:
        y: (time,), any unit, finite.
        u: (time,), the input, any unit, if known.
        sensor_step: Step of the sensor, in the unit of y; None takes the smallest difference between values
            of y, which is not the sensor's step if y was interpolated.

    Returns:
        (dropouts,), int, increasing.

    Example:
        >>> import numpy as np
        >>> from torchpi.recordings.faults import dropouts
        >>> y = np.sin(np.arange(200) / 20)
        >>> y[70] = 5.0
        >>> dropouts(y).tolist()
        [70]
    """
    from scipy.special import ndtri

    if len(y) < 9:
        return np.empty(0, dtype=int)
    steps, apart = np.diff(y), beyond_neighbours(y)
    of_noise = np.sqrt(1.5) * noise_estimate(y) * -ndtri(FALSE_ALARM / (2 * len(y)))
    step = least_step(y) if sensor_step is None else sensor_step
    found = np.flatnonzero(apart > max(of_noise, 3 * step)) + 1
    around = found[:, None] + np.array([-5, -4, -3, -2, 1, 2, 3, 4])
    inside = (around >= 0) & (around < len(steps))
    near = np.where(inside, np.abs(steps[np.clip(around, 0, len(steps) - 1)]), np.nan)
    motion = np.nanmedian(near, axis=1) if len(found) else np.empty(0)
    found = np.asarray(found[apart[found - 1] > MOTION_FACTOR * motion])
    if u is None:
        return found
    if len(found) and np.ptp(u) > 0:
        before = np.clip(found[:, None] - 1 - np.arange(LATEST + 1), 0, None)
        moved = np.ptp(np.delete(y, found)) / np.ptp(u) * beyond_neighbours(u)[before].max(axis=1)
        found = found[apart[found - 1] > MOTION_FACTOR * moved]
    return np.union1d(found[~beside_steps(found, u)] if len(found) else found, repeated_value(y, u, step))


def beyond_neighbours(x: np.ndarray) -> np.ndarray:
    """Return (time - 2,): how far each value, but the first and last, lies beyond both neighbours, else 0."""
    steps = np.diff(x)
    apart: np.ndarray = np.minimum(np.abs(steps[:-1]), np.abs(steps[1:]))
    return np.where(steps[:-1] * steps[1:] < 0, apart, 0.0)


def repeated_value(y: np.ndarray, u: np.ndarray, sensor_step: float) -> np.ndarray:
    """Return indices of single readings of one value, such as zero, that recurs far more often than others.

    Readings with an equal neighbour are left out, because a stage at rest repeats its reading. A value to
    which the input repeatedly drives the stage is left out too.

    Args:
        y: (time,), any unit, finite.
        u: (time,), the input, any unit.
        sensor_step: Step of the sensor, in the unit of y, more than 0.

    Returns:
        (readings,), int, increasing.
    """
    from scipy.special import pdtrc

    none = np.empty(0, dtype=int)
    moves = np.diff(y)
    single = np.flatnonzero((moves[:-1] != 0) & (moves[1:] != 0)) + 1
    if not len(single) or not sensor_step > 0:
        return none
    values, place, counts = np.unique(y[single], return_inverse=True, return_counts=True)
    often, most = int(counts.argmax()), int(counts.max())
    by_chance = DENSER * len(y) * sensor_step / np.ptp(y)
    if most <= OFTENER * np.quantile(counts, 0.99) or len(values) * pdtrc(most - 1, by_chance) > FALSE_ALARM:
        return none
    found = single[place == often]
    return found if u[found].std() > SPREAD * u.std() else none


def beside_steps(readings: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return (readings,), bool: which lie beside a step of u, if there are more than by chance."""
    from scipy.special import bdtrc

    moves = np.abs(np.diff(u))
    stepped = np.flatnonzero(moves > STEP * np.ptp(u))
    beside = np.zeros(len(u), dtype=bool)
    for later in range(1 - RINGING, LATEST + 1):
        beside[np.clip(stepped + later, 0, len(u) - 1)] = True
    there, share = beside[readings], float(beside.mean())
    by_chance = float(bdtrc(there.sum() - 1, len(readings), share)) if there.any() else 1.0
    return np.asarray(there & (by_chance < FALSE_ALARM))


def as_last_read(x: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(time,): a signal in which each sample that does not count repeats the last one that does; the first
    sample stands for itself."""
    return x[np.maximum.accumulate(np.where(counts, np.arange(len(x)), 0))]


def least_step(x: np.ndarray) -> float:
    """Return the smallest difference between values of x that exceeds rounding: the sensor's step."""
    gaps = np.diff(np.unique(x))
    gaps = gaps[gaps > ROUNDING * np.abs(x).max()]
    return float(gaps.min()) if len(gaps) else 0.0


def in_phase_correlation(u: np.ndarray, y: np.ndarray) -> float:
    """Return the correlation of u and y at the same instant, y without linear drift; its sign is the gain's.

    It is 0 if only rounding is left of y.
    """
    size, u, y = np.abs(y).max(), u - u.mean(), without_line(y) if len(y) > 2 else y - y.mean()
    scale = np.sqrt(float(u @ u) * float(y @ y))
    return float(u @ y) / scale if scale > 0 and np.abs(y).max() > ROUNDING * size else 0.0


def lead_of_output(u: np.ndarray, y: np.ndarray) -> float:
    """Return how far y leads u: the signed area of the loop, Σ y Δu, over Σ|Δu|·std(y).

    Hysteresis, lag, delay and creep make it negative, whatever the sign of the gain: for a sine that lags by
    δ it is −1.11 sin δ. If it is positive, the output leads. By chance, the part of y that is not in phase
    with u, of standard deviation σ, gives up to 5σ/(√n std(y)) for n samples.

    Args:
        u, y: (time,).

    Returns:
        The lead if it exceeds both chance and one degree, else 0.
    """
    centred = y - y.mean()
    power, path = float((u - u.mean()) @ (u - u.mean())), float(np.abs(np.diff(u)).sum())
    if power == 0 or path == 0:
        return 0.0
    gain = float((u - u.mean()) @ centred) / power
    beside = centred - gain * (u - u.mean())  # in-phase motion encloses no area, but adds to an open path
    lead = float((beside[1:] + beside[:-1]) @ np.diff(u)) / 2 / (path * float(y.std()) or np.inf)
    lead *= np.sign(gain) or 1.0
    chance = 5 * float(beside.std()) / (np.sqrt(len(y)) * float(y.std()) or np.inf)
    return lead if lead > max(LEAST_LEAD, chance) else 0.0


def without_line(x: np.ndarray) -> np.ndarray:
    """Return x without its mean and its linear drift."""
    index = np.arange(len(x)) - (len(x) - 1) / 2
    centred = x - x.mean()
    return np.asarray(centred - index * (index @ centred / (index @ index)))
