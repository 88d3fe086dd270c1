"""The part of an effect that remains after the plain plant's plays are refitted and needs new physics."""

from collections.abc import Mapping, Sequence

import numba
import numpy as np
from concealed.plant.physics import Array
from concealed.plant.rig import Run

THRESHOLDS = np.concatenate([[0.0], np.geomspace(1e-3, 0.7, 39)])  # of the span
TICKS_LATE = {"end_of_hold": 0, "before_write": 1}
"""For each timing convention, by how many ticks a reading is later than the command that it responds to."""


def beyond_plays_um(
    with_effect: Array, without: Mapping[str, Array], timing: str, runs: Sequence[Run], span_v: float
) -> float:
    """Rms, µm, of the part of an effect that no linear plays fit, under either timing convention.

    No tool knows the convention. Readings later by what separates the two are those of the other one, and no
    effect; so the least is taken of what remains under each, beside the rig's own with plays of u(k).

    Args:
        with_effect: Readings with the effect, runs end to end, shape (readings,), µm.
        without: The readings of the same rig without it, under each timing convention, likewise.
        timing: The convention of `with_effect`.
        runs: What is recorded, with a reading at every tick.
        span_v: The thresholds are multiples of it, V.
    """
    pairs = {(timing, 0), *TICKS_LATE.items()}
    return min(
        _unfitted_um(with_effect - without[convention], _columns(runs, span_v, late))
        for convention, late in pairs
    )


def _columns(runs: Sequence[Run], span_v: float, late: int) -> Array:
    """Forty plays of u(k - late), V, and a one for the offset, shape (readings, 41)."""
    states = []
    for run in runs:
        u = np.concatenate([np.zeros(late), run.u])[: run.u.size]  # the stage starts de-energised
        states.append(_play_states(u, THRESHOLDS * span_v)[run.history :])
    plays = np.concatenate(states)
    return np.column_stack([plays, np.ones(len(plays))])


def _unfitted_um(difference: Array, columns: Array) -> float:
    """Rms, µm, of what the columns leave of a difference, shape (readings,), µm, by least squares."""
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
