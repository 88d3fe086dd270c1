"""Reduce long recordings to a lower rate, or to their beginning, so that a search takes minutes."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import welch

from torchpi.recordings.faults import as_last_read
from torchpi.recordings.recording import Recording

AT_MOST = 100_000
"""Maximum number of samples of all recordings together."""
LEAST = 2_000
"""Recordings that would be reduced to fewer samples stay as they are."""
FAST = 0.05
"""Ratio of a voltage's rms within the blocks of means to its own rms, above which it is too fast for means:
of a sine they lose about half the ratio's square, here 0.1 %, at each turning point. The same ratio of ranges
from which a single mean does not count."""
SEGMENT = 4096
"""Number of samples per segment of a spectrum."""
ABOVE = 3.0
"""Multiple of the expected spectrum and its noise above which an excess is more than scatter."""
LITTLE = 1e-4
"""Share of the travel below which nothing is looked for, whatever the noise."""


def at_a_lower_rate(
    recordings: Sequence[Recording], dropouts: Sequence[np.ndarray]
) -> tuple[list[Recording], list[np.ndarray], tuple[str, ...]]:
    """Reduce the recordings to block means with about `AT_MOST` samples in all. Recordings of a fast voltage,
    and those that ring faster than the means show, keep as many of their first samples instead.

    A block mean does not overshoot at a step, so no play sees a false reversal. But a play responds to every
    turning point, and the means of a fast voltage have different ones.

    Args:
        recordings: One or more.
        dropouts: For each recording, the indices of readings that do not count; before means are taken,
            these get the value of the last good reading.

    Returns:
        The recordings, the dropouts that are left in them, and sentences for the report on what changed.
    """
    samples = sum(len(recording) for recording in recordings)
    if samples <= AT_MOST:
        return list(recordings), list(dropouts), ()
    factor = math.ceil(samples / AT_MOST)
    kept, left, averaged, notes = [], [], [], []
    for recording, wrong in zip(recordings, dropouts, strict=True):
        count = len(recording) // factor
        if count < LEAST:
            kept.append(recording)
            left.append(wrong)
            continue
        good = np.ones(len(recording), dtype=bool)
        good[wrong] = False
        bridged = replace(recording, y=as_last_read(recording.y, good))
        moves = fast(recording.u, factor)
        if moves or rings_above(bridged, factor):
            kept.append(recording.slice(recording.t[0], recording.t[count]))
            left.append(wrong[wrong < count])
            why = "its voltage changes too fast" if moves else "it rings too fast"
            notes.append(
                f"{recording.name}: only the first {count / recording.fs_hz:.4g} s of "
                f"{len(recording) / recording.fs_hz:.4g} s are used; {why} to be averaged over {factor} "
                "samples."
            )
        else:
            kept.append(_of_means(bridged, factor))
            left.append(np.zeros(0, dtype=int))
            averaged.append(kept[-1])
    if averaged:
        fastest = max(recording.fs_hz for recording in averaged) / 2
        notes.insert(
            0,
            f"{samples:,} samples: averaged over {factor} at a time; nothing faster than {fastest:.3g} Hz "
            "was looked for. To see that, diagnose an excerpt of a recording.",
        )
    return kept, left, tuple(notes)


def fast(u: np.ndarray, factor: int) -> bool:
    """Whether a voltage, (time,), moves too much within blocks of `factor` samples."""
    blocks = u[: len(u) // factor * factor].astype(np.float64).reshape(-1, factor)
    within = blocks - blocks.mean(1, keepdims=True)
    return bool(within.std() > FAST * blocks.std())


def across_steps(u: np.ndarray, factor: int) -> np.ndarray:
    """Return the indices of the means over `factor` samples of a voltage, (time,), in which it moves far, or
    would if it came a sample earlier or later: a hysteresis is curved, so that the mean of its output is not
    its output at the mean."""
    whole = len(u) // factor * factor
    moved = [np.ptp(shifted(u, late)[:whole].reshape(-1, factor), axis=1) for late in (-1, 0, 1)]
    return np.flatnonzero(np.max(moved, axis=0) > FAST * np.ptp(u))


def rings_above(recording: Recording, factor: int) -> bool:
    """Whether the readings contain, above the band of block means, more power than the voltage explains, by
    more than the noise: a mode, which means would alias to a frequency where there is none."""
    fs_hz, travel_um = recording.fs_hz, float(np.ptp(recording.y))
    f, of_u = welch(recording.u, fs_hz, nperseg=SEGMENT)
    _, of_y = welch(recording.y, fs_hz, nperseg=SEGMENT)
    gain = travel_um / max(float(np.ptp(recording.u)), 1e-300)
    noise = max(float(np.quantile(of_y, 0.1)), (LITTLE * travel_um) ** 2 / (fs_hz / 2))
    beyond = (of_y - ABOVE * (gain**2 * of_u + noise))[f > fs_hz / factor / 2]
    return bool(np.maximum(beyond, 0.0).sum() > noise * len(f))


def means(x: np.ndarray, factor: int) -> np.ndarray:
    """Return the means of a signal, (time,), over blocks of `factor` samples; a partial block is dropped."""
    whole = len(x) // factor * factor
    found: np.ndarray = x[:whole].astype(np.float64).reshape(-1, factor).mean(1)
    return found


def shifted(
    x: np.ndarray,  # (time,)
    samples: int,
) -> np.ndarray:  # (time,)
    """Return the signal shifted later by so many samples, or earlier if negative; its ends are held."""
    places = np.arange(len(x)) - samples
    return x[np.clip(places, 0, len(x) - 1)]


def _of_means(recording: Recording, factor: int) -> Recording:
    return replace(
        recording,
        t=means(recording.t, factor),
        u=means(recording.u, factor),
        y=means(recording.y, factor),
        fs_hz=recording.fs_hz / factor,
        aux={name: means(x, factor) for name, x in recording.aux.items()},
        simulated=None if recording.simulated is None else means(recording.simulated, factor),
        filled=None,
        late_s=None,
    )
