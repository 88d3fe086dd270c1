"""A voltage that was monitored has noise of its own, which never drove the stage.

Left there, it is a reason for any lag in front of the hysteresis: a filter of the noise predicts better than
the noise (errors in variables: Söderström, *Errors-in-Variables Methods in System Identification*, 2018).
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_filter

SMALLEST, LARGEST = 1e-6, 0.005
"""Of the span: what scatters less is the rounding of a file, what scatters more is a command."""
BENT = 70.0
"""The sum of the squares of 1, 4, 6, 4, 1: the variance of fourth differences of white noise."""
OF_WHITE = (-0.8, 0.4)
"""Their autocorrelations at one and two samples."""
WITHIN = 0.03
"""Of these: those of integrated white noise, -0.75 and 0.3, are farther away."""
SCATTER = (0.5, 1.2)
"""Times 1/√samples: standard deviations of the two autocorrelations, by simulation."""
BLOCK, LEAST = 32, 8
"""Samples among which a voltage is quiet or is not, and how many such blocks show noise."""
QUIET = 1.5
"""Times the noise, which no block of it alone scatters."""
WINDOWS = tuple(2**k + 1 for k in range(2, 11))
"""Samples of a local parabola."""
SURE = 3.0
"""Standard deviations of a local estimate within which those of smaller windows lie."""
AROUND, SPARE = 1025, 1.06
"""Samples before or after one whose mean square about their parabolas may be that of the noise, within `SURE`
standard deviations and what the noise itself is uncertain by: a few samples alone do not tell a turn of the
command from noise of its size."""


def monitor_noise(voltages: Sequence[np.ndarray]) -> list[float]:
    """Of each voltage, (time,), V: the standard deviation of its monitor's white noise, V; 0 for a command.

    The noise shows where a voltage rests or moves slowly, which a random one does not between its holds. One
    monitor has read all voltages, with the median of their noise: those that show none too, unless they are
    quieter. One that shows more than twice the least has been read by another.
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
    """What a voltage, (time,), scatters about local cubics where it scatters least, V, and whether that is
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
    """(time,), V: each sample on the longest local parabola that no shorter one contradicts; and the standard
    deviation of what is left of its noise, (time,), V.

    The windows are chosen by intersection of confidence intervals (Goldenshluger and Nemirovski,
    *Mathematical Methods of Statistics* 6, 1997): edges and corners stay where they are. Nor may a window
    take out more than noise of the samples before or after one that no window contradicted.

    Args:
        u: (time,), V.
        sd: Of its noise, V; 0 for a command, which comes back as it is.
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
    """(time,), bool: whether more than noise was taken out of the samples on one side.

    Args:
        going: (time,), bool: the samples that count.
        taken: (time,), V, out of each.
        kept: Of the variance of the noise, what a window keeps.
        sd: Of the noise, V.
        side: -1 for those before, 1 for those after.
    """
    counted, mean = (
        uniform_filter1d(x, AROUND, origin=-side * (AROUND // 2))
        for x in (going.astype(float), np.where(going, taken**2, 0.0))
    )
    most = SPARE + SURE * np.sqrt(2 / np.maximum((1 - kept) * AROUND * counted, 1.0))
    found: np.ndarray = mean > (1 - kept) * sd**2 * most * counted
    return found
