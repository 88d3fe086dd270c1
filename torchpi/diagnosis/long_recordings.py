"""Long recordings at a lower rate, or their beginning: a search works on what fits in about a minute."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import welch

from torchpi.recordings.recording import Recording

AT_MOST = 200_000
"""Samples of all recordings together."""
LEAST = 2_000
"""Samples of a recording that stays as it is."""
FAST = 0.05
"""Rms of a voltage within the samples of a mean, over its own, from which it is too fast for means: of a sine
they lose some half of its square, here 0.1 %, at each turning point."""
SEGMENT = 4096
"""Samples of which a spectrum is made."""
ABOVE = 3.0
"""Times a spectrum, and what noise is in it, from which more is no scatter."""
LITTLE = 1e-4
"""Of the travel: less than that is not looked for, whatever the noise."""


def at_a_lower_rate(
    recordings: Sequence[Recording], dropouts: Sequence[np.ndarray]
) -> tuple[list[Recording], list[np.ndarray], tuple[str, ...]]:
    """The recordings as means of so many samples at a time that together they are `AT_MOST`, those of a fast
    voltage, and those that ring faster than means show, by as many of their first samples; and notes.

    A mean over a block has no overshoot at a step, so that no play sees a reversal that was none. But a play
    sees every turning point, and means of a fast voltage have others.

    Args:
        recordings: One or more.
        dropouts: For each the indices of readings that do not count; where means are taken, they take the
            value of the reading before.

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
        last = np.maximum.accumulate(np.where(good, np.arange(len(recording)), 0))
        bridged = replace(recording, y=recording.y[last])
        moves = fast(recording.u, factor)
        if moves or rings_above(bridged, factor):
            kept.append(recording.slice(recording.t[0], recording.t[count]))
            left.append(wrong[wrong < count])
            why = "its voltage is too fast" if moves else "it rings too fast"
            notes.append(
                f"{recording.name}: the first {count / recording.fs_hz:.4g} s of "
                f"{len(recording) / recording.fs_hz:.4g} s; {why} for means of {factor}."
            )
        else:
            kept.append(_of_means(bridged, factor))
            left.append(np.zeros(0, dtype=int))
            averaged.append(kept[-1])
    if averaged:
        fastest = max(recording.fs_hz for recording in averaged) / 2
        notes.insert(
            0,
            f"{samples:,} samples: worked on as means of {factor} at a time; nothing faster than "
            f"{fastest:.3g} Hz was looked for. An excerpt of a recording shows that.",
        )
    return kept, left, tuple(notes)


def fast(u: np.ndarray, factor: int) -> bool:
    """Whether a voltage, (time,), moves much within so many samples."""
    blocks = u[: len(u) // factor * factor].astype(np.float64).reshape(-1, factor)
    within = blocks - blocks.mean(1, keepdims=True)
    return bool(within.std() > FAST * blocks.std())


def rings_above(recording: Recording, factor: int) -> bool:
    """Whether the readings have more that is faster than means of so many samples show, beyond what the
    voltage has there, than there is noise: a mode, which means would fold down to where there is none."""
    fs_hz, travel_um = recording.fs_hz, float(np.ptp(recording.y))
    f, of_u = welch(recording.u, fs_hz, nperseg=SEGMENT)
    _, of_y = welch(recording.y, fs_hz, nperseg=SEGMENT)
    gain = travel_um / max(float(np.ptp(recording.u)), 1e-300)
    noise = max(float(np.quantile(of_y, 0.1)), (LITTLE * travel_um) ** 2 / (fs_hz / 2))
    beyond = (of_y - ABOVE * (gain**2 * of_u + noise))[f > fs_hz / factor / 2]
    return bool(np.maximum(beyond, 0.0).sum() > noise * len(f))


def means(x: np.ndarray, factor: int) -> np.ndarray:
    """Of a signal, (time,), over blocks of so many samples; what does not fill the last one is left out."""
    whole = len(x) // factor * factor
    found: np.ndarray = x[:whole].astype(np.float64).reshape(-1, factor).mean(1)
    return found


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
    )
