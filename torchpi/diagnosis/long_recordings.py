"""Long recordings at a lower rate: a search works on as many samples as it can fit in a minute or so."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from torchpi.recordings.recording import Recording

AT_MOST = 200_000
"""Samples of all recordings together."""
LEAST = 2_000
"""Samples of a recording that stays as it is."""


def at_a_lower_rate(
    recordings: Sequence[Recording], dropouts: Sequence[np.ndarray]
) -> tuple[list[Recording], list[np.ndarray], tuple[str, ...]]:
    """The recordings as means of so many samples at a time that together they are `AT_MOST`; and a note.

    A mean over a block has no overshoot at a step, so that no play sees a reversal that was none.

    Args:
        recordings: One or more.
        dropouts: For each the indices of readings that do not count; where means are taken, they take the
            value of the reading before.

    Returns:
        The recordings, the dropouts that are left in them, and a sentence for the report, if any changed.
    """
    samples = sum(len(recording) for recording in recordings)
    if samples <= AT_MOST:
        return list(recordings), list(dropouts), ()
    factor = math.ceil(samples / AT_MOST)
    kept, left = [], []
    for recording, wrong in zip(recordings, dropouts, strict=True):
        if len(recording) < LEAST * factor:
            kept.append(recording)
            left.append(wrong)
            continue
        good = np.ones(len(recording), dtype=bool)
        good[wrong] = False
        last = np.maximum.accumulate(np.where(good, np.arange(len(recording)), 0))
        kept.append(_means(replace(recording, y=recording.y[last]), factor))
        left.append(np.zeros(0, dtype=int))
    fastest = max(recording.fs_hz for recording in kept) / 2
    note = (
        f"{samples:,} samples: worked on as means of {factor} at a time; nothing faster than "
        f"{fastest:.3g} Hz was looked for. An excerpt of a recording shows that."
    )
    return kept, left, (note,)


def _means(recording: Recording, factor: int) -> Recording:
    """Over blocks of samples; what does not fill the last one is left out."""

    def means(x: np.ndarray) -> np.ndarray:
        whole = len(x) // factor * factor
        found: np.ndarray = x[:whole].astype(np.float64).reshape(-1, factor).mean(1)
        return found

    simulated = recording.simulated
    return replace(
        recording, t=means(recording.t), u=means(recording.u), y=means(recording.y),
        fs_hz=recording.fs_hz / factor, aux={name: means(x) for name, x in recording.aux.items()},
        simulated=None if simulated is None else means(simulated),
    )  # fmt: skip
