"""Removal of the noise that a monitor adds to the recorded voltage, which never drove the stage.

If the noise is left in, it favours any lag before the hysteresis: filtered noise predicts better than noise
itself (errors in variables: Söderström, *Errors-in-Variables Methods in System Identification*, 2018).
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_filter

SMALLEST, LARGEST = 1e-6, 0.005
"""Shares of the span: less scatter is the rounding of a file, more scatter belongs to the command."""
BENT = 70.0
"""Sum of the squares of 1, 4, 6, 4, 1: the variance of fourth differences of unit white noise."""
OF_WHITE = (-0.8, 0.4)
"""Autocorrelations of these fourth differences at one and two samples."""
WITHIN = 0.03
"""Tolerance of these: those of integrated white noise, -0.75 and 0.3, are farther away."""
SCATTER = (0.5, 1.2)
"""Standard deviations of the two autocorrelations, times √samples, from simulation."""
BLOCK, LEAST = 32, 8
"""Samples of a block that is judged quiet or not, and the number of blocks needed to show noise."""
QUIET = 1.5
"""Multiple of the noise that the scatter of a block of noise alone never reaches."""
WINDOWS = tuple(2**k + 1 for k in range(2, 11))
"""Numbers of samples that a local parabola is fitted to."""
SURE = 3.0
"""Standard deviations of a local estimate within which it must agree with those of smaller windows."""
AROUND, SPARE = 1025, 1.06
"""Number of samples before or after a sample whose mean square about their parabolas is compared with the
noise, and the allowance for the uncertainty of the noise, besides `SURE` standard deviations: a few samples
alone cannot distinguish a turn of the command from noise of its size."""


def monitor_noise(voltages: Sequence[np.ndarray]) -> list[float]:
    """Return the standard deviation, V, of the monitor's noise in each voltage, (time,), V; 0 for a command.

    The noise, which is white, shows where a voltage rests or moves slowly; a random voltage does so only in
    its holds. All voltages are taken to come from one monitor with their median noise, including those that
    show none unless they are quieter. A voltage with more than twice the least noise is another monitor's.
    """
    quiet = [_quietest(u) for u in voltages]
    own = [sd if white and _is_noise(sd, u) else 0.0 for (sd, white), u in zip(quiet, voltages, strict=True)]
    same = 2 * min(filter(None, own), default=0.0)
    common = float(np.median([one for one in own if 0 < one <= same] or [0.0]))
    shown = [one or (common if QUIET * sd > common else 0.0) for one, (sd, _) in zip(own, quiet, strict=True)]
    return [common if 0 < one <= same else one for one in shown]


def _is_noise(sd: float, u: np.ndarray) -> bool:
    return SMALLEST < sd / max(float(np.ptp(u)), 1e-300) < LARGEST


def _quietest(u: np.ndarray) -> tuple[float, bool]:
    """Return the scatter of a voltage, (time,), about local cubics where it is least, V, and whether it is
    white noise."""
    bent = np.diff(u, 4)
    blocks = bent[: len(bent) // BLOCK * BLOCK].reshape(-1, BLOCK)
    if len(blocks) < LEAST:
        return 0.0, False
    scatter = np.sqrt((blocks**2).mean(axis=1) / BENT)
    sd = QUIET * float(np.partition(scatter, LEAST - 1)[LEAST - 1])
    for _ in range(10):
        calm = blocks[scatter <= QUIET * sd]
        sd = float(np.sqrt((calm**2).mean() / BENT))
    for k, (expected, error) in enumerate(zip(OF_WHITE, SCATTER, strict=True), 1):
        found = float((calm[:, k:] * calm[:, :-k]).mean() / max(float((calm**2).mean()), 1e-300))
        if abs(found - expected) > WITHIN + 2 * error / np.sqrt(calm.size):
            return sd, False
    return sd, True


def without_noise(u: np.ndarray, sd: float) -> tuple[np.ndarray, np.ndarray]:
    """Return each sample on the longest local parabola that no shorter one contradicts, (time,), V, and the
    standard deviation of the noise that is left in it, (time,), V.

    The windows are chosen by intersection of confidence intervals (Goldenshluger and Nemirovski,
    *Mathematical Methods of Statistics* 6, 1997), which keeps edges and corners in place. A window that
    removes more than noise from the uncontradicted samples both before and after a sample is refused too.

    Args:
        u: (time,), V.
        sd: Standard deviation of its noise, V; 0 for a command, which is returned unchanged.
    """
    left = np.full(len(u), sd)
    if sd == 0.0:
        return u, left
    smooth, going = u.copy(), np.ones(len(u), dtype=bool)
    low, high = u - SURE * sd, u + SURE * sd
    for window in WINDOWS:
        if window > len(u):
            break
        impulse = np.zeros(window)
        impulse[window // 2] = 1.0
        kernel = savgol_filter(impulse, window, 2)
        kept = float(kernel @ kernel)
        of_estimate = sd * float(np.sqrt(kept))
        estimate = savgol_filter(u, window, 2)
        low = np.maximum(low, estimate - SURE * of_estimate)
        high = np.minimum(high, estimate + SURE * of_estimate)
        going &= low <= high
        taken = u - estimate
        before, after = (_too_much(going, taken, kept, sd, side) for side in (-1, 1))
        going &= ~(before & after)
        smooth[going], left[going] = estimate[going], of_estimate
    return smooth, left


def _too_much(going: np.ndarray, taken: np.ndarray, kept: float, sd: float, side: int) -> np.ndarray:
    """Whether more than noise was removed from the samples on one side of each, (time,), bool.

    Args:
        going: (time,), bool: the samples that count.
        taken: (time,), V, removed from each.
        kept: Share of the variance of the noise that a window keeps.
        sd: Standard deviation of the noise, V.
        side: -1 for the samples before, 1 for those after.
    """
    counted, mean = (
        uniform_filter1d(x, AROUND, origin=-side * (AROUND // 2))
        for x in (going.astype(float), np.where(going, taken**2, 0.0))
    )
    most = SPARE + SURE * np.sqrt(2 / np.maximum((1 - kept) * AROUND * counted, 1.0))
    found: np.ndarray = mean > (1 - kept) * sd**2 * most * counted
    return found
