"""The part of an effect that remains after the plain plant's plays are refitted and needs new physics."""

from collections.abc import Sequence

import numba
import numpy as np
from concealed.plant.physics import Array
from concealed.plant.rig import Run

THRESHOLDS = np.concatenate([[0.0], np.geomspace(1e-3, 0.7, 39)])  # of the span


def beyond_plays_um(difference: Array, runs: Sequence[Run], span_v: float) -> float:
    """Rms of the part of `difference` that forty linear plays and an offset cannot fit (runs end to end)."""
    columns = np.concatenate([_play_states(run.u, THRESHOLDS * span_v)[run.history :] for run in runs])
    columns = np.column_stack([columns, np.ones(len(columns))])
    gram = columns.T @ columns
    gram[np.diag_indices_from(gram)] *= 1 + 1e-10
    weights = np.linalg.solve(gram, columns.T @ difference)
    return float(np.sqrt(np.mean((difference - columns @ weights) ** 2)))


@numba.njit(cache=True)
def _play_states(u, thresholds):
    h, out = np.zeros(thresholds.size), np.empty((u.size, thresholds.size))
    for t in range(u.size):
        for i in range(thresholds.size):
            h[i] = min(max(h[i], u[t] - thresholds[i]), u[t] + thresholds[i])
            out[t, i] = h[i]
    return out
