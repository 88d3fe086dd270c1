"""What a recorded signal shows of itself: its noise, single wrong readings, and which of two comes first."""

import numpy as np

MOTION_FACTOR = 4.0
"""A reading stands apart by so many times the samples' usual step; a triangle's corner does by one."""
FALSE_ALARM = 1e-3
"""The chance that noise alone makes a dropout anywhere in a record."""
DENSER, OFTENER, SPREAD = 3.0, 5.0, 0.5
"""Times the mean density of readings, that of a value that a stage passes often; times that other values come
again, from where one comes again too often; of the scatter of the input, what it has where it does."""
STEP, RINGING = 0.02, 2
"""Of its range, a move of the input from one sample to the next that is a step; samples before and after it
in which filters ring."""
LEAST_LEAD = 0.02  # about one degree of a sine
ROUNDING = 1e-9
"""Of the largest value of a signal."""


def noise_estimate(y: np.ndarray) -> float:
    """Standard deviation of what changes from sample to sample without pattern, in the signal's unit.

    The median of |y(k) − cubic through its four neighbours|: white noise σ leaves √(35/18)·σ of it, motion
    that is slow against the sample rate nothing. Where motion is fast it is an upper bound; where a converter
    rounds all noise away it is zero.

    Args:
        y: (time,).
    """
    if len(y) < 5:
        return 0.0
    residual = y[2:-2] - (4 * (y[1:-3] + y[3:-1]) - y[:-4] - y[4:]) / 6
    return float(robust_sd(residual) / np.sqrt(35 / 18))


def robust_sd(x: np.ndarray, axis: int | None = None) -> np.ndarray:
    """The standard deviation of Gaussian values about 0, whatever a few of them are, in their unit.

    From the median of their sizes (Hampel, *J. American Statistical Association* 69, 1974).

    Args:
        x: (…, time).
        axis: Along which; None is over all.
    """
    sd: np.ndarray = 1.4826 * np.median(np.abs(x), axis=axis)
    return sd


def dropouts(y: np.ndarray, u: np.ndarray | None = None, sensor_step: float | None = None) -> np.ndarray:
    """Indices of isolated wrong readings, such as one zero among readings of 5 µm.

    A reading is wrong where it lies beyond both its neighbours, on the same side, by more than noise and by
    more than motion: the lesser of |y(k) − y(k−1)| and |y(k) − y(k+1)| exceeds

    - √1.5·σ·Φ⁻¹(1 − α/2n), which white noise of σ (`noise_estimate`) exceeds anywhere in n samples with
      probability α = 0.001 at most: the mean of the two differences has variance 1.5 σ²;
    - 4 times the median of the eight nearest other steps, of which a corner of a triangle reaches one;
    - 3 steps of the sensor, because rounding makes lone steps of one.

    In fast motion a zero may lie between its neighbours: so are the readings of a value that comes again too
    often, see `repeated_value`.

    The first and last sample, which have one neighbour, are never among them; nor are two wrong readings in a
    row. Nor are those beside steps of the input, where more of them are than anywhere else: an overshoot of a
    sample or two is the stage's answer, or a filter's without phase.

    Args:
        y: (time,), any unit, finite.
        u: (time,), the input, any unit, where it is known.
        sensor_step: Of the sensor, in the unit of y; None takes the smallest between values of y, which is
            none where y was interpolated.

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
    steps = np.diff(y)
    apart = np.where(steps[:-1] * steps[1:] < 0, np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])), 0.0)
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
    return np.union1d(found[~_beside_steps(found, u)] if len(found) else found, repeated_value(y, u, step))


def repeated_value(y: np.ndarray, u: np.ndarray, sensor_step: float) -> np.ndarray:
    """Indices of single readings of one value, such as zero, that comes again far more often than others do.

    Readings with an equal neighbour are left out: a stage at rest repeats itself. So is a value to which the
    input sends the stage again and again.

    Args:
        y: (time,), any unit, finite.
        u: (time,), the input, any unit.
        sensor_step: In the unit of y, more than 0.

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


def _beside_steps(readings: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(readings,), bool: which lie beside a step of u, if so many are no chance."""
    from scipy.special import bdtrc

    moves = np.abs(np.diff(u))
    stepped = np.flatnonzero(moves > STEP * np.ptp(u))
    beside = np.zeros(len(u), dtype=bool)
    for later in range(1 - RINGING, RINGING + 1):
        beside[np.clip(stepped + later, 0, len(u) - 1)] = True
    there, share = beside[readings], float(beside.mean())
    by_chance = float(bdtrc(there.sum() - 1, len(readings), share)) if there.any() else 1.0
    return np.asarray(there & (by_chance < FALSE_ALARM))


def least_step(x: np.ndarray) -> float:
    """The smallest difference between values of x that is more than rounding: the sensor's step."""
    gaps = np.diff(np.unique(x))
    gaps = gaps[gaps > ROUNDING * np.abs(x).max()]
    return float(gaps.min()) if len(gaps) else 0.0


def in_phase_correlation(u: np.ndarray, y: np.ndarray) -> float:
    """Correlation of u and y at the same instant, a linear drift of y left out: its sign is the gain's.

    0 where nothing else is left of y but rounding.
    """
    size, u, y = np.abs(y).max(), u - u.mean(), without_line(y) if len(y) > 2 else y - y.mean()
    scale = np.sqrt(float(u @ u) * float(y @ y))
    return float(u @ y) / scale if scale > 0 and np.abs(y).max() > ROUNDING * size else 0.0


def lead_of_output(u: np.ndarray, y: np.ndarray) -> float:
    """How far y runs ahead of u: the signed area of the loop, Σ y Δu, over Σ|Δu|·std(y).

    Hysteresis, lag, delay and creep make it negative, whatever the gain's sign: for a sine that lags by δ it
    is −1.11 sin δ. Positive, the output comes first; of n samples, what is not in phase with u makes up to
    5σ/(√n std(y)) by chance, where σ is its standard deviation.

    Args:
        u, y: (time,).

    Returns:
        The lead where it is beyond chance and beyond a degree, else 0.
    """
    centred = y - y.mean()
    power, path = float((u - u.mean()) @ (u - u.mean())), float(np.abs(np.diff(u)).sum())
    if power == 0 or path == 0:
        return 0.0
    gain = float((u - u.mean()) @ centred) / power
    beside = centred - gain * (u - u.mean())  # what is in phase encloses no area, but an open path counts it
    lead = float((beside[1:] + beside[:-1]) @ np.diff(u)) / 2 / (path * float(y.std()) or np.inf)
    lead *= np.sign(gain) or 1.0
    chance = 5 * float(beside.std()) / (np.sqrt(len(y)) * float(y.std()) or np.inf)
    return lead if lead > max(LEAST_LEAD, chance) else 0.0


def without_line(x: np.ndarray) -> np.ndarray:
    """x without its mean and its linear drift."""
    index = np.arange(len(x)) - (len(x) - 1) / 2
    centred = x - x.mean()
    return np.asarray(centred - index * (index @ centred / (index @ index)))
