"""The prior of a random walk: its increments have one size, even where no reading determines its place.

Knots after the last fitted reading, and between recordings of different lengths, are determined by nothing
else: without the prior a walk could end anywhere. The size is that of the increments from which a fit begins
(empirical Bayes: Efron and Morris, *J. American Statistical Association* 68, 1973).
"""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.hypothesis import FreeParameter, Hypothesis
from torchpi.recordings.faults import robust_sd


def walk_prior(hypothesis: Hypothesis, slots: Sequence[FreeParameter], theta: np.ndarray) -> np.ndarray:
    """Return the inverse covariance of the slots, (slots, slots), 0 for those that are not on a walk.

    Args:
        hypothesis: The hypothesis with its effects.
        slots: Its free parameters.
        theta: (slots,), their values on the scale on which they are fitted.
    """
    at = {(slot.member, slot.name, slot.record): j for j, slot in enumerate(slots)}
    found = np.zeros((len(slots), len(slots)))
    for k, member in enumerate(hypothesis.members):
        if not member.effect.walk:
            continue
        walks = [
            [at[key] for name in member.effect.walk if (key := (k, name, record)) in at]
            for record in range(len(member.own))
        ]
        steps = np.concatenate([found[:0], *(_increments(slots, knots) for knots in walks)])
        size = _size(steps @ theta)
        if size > 0:
            found += steps.T @ steps / size**2
    return found


def _increments(slots: Sequence[FreeParameter], knots: Sequence[int]) -> np.ndarray:
    """(knots, slots): the increments of one walk, starting from 0, as combinations of the slots."""
    values = np.zeros((len(knots) + 1, len(slots)))
    for row, j in enumerate(knots, 1):
        values[row, j] = slots[j].scale
    return np.diff(values, axis=0)


def _size(increments: np.ndarray) -> float:
    """Return the standard deviation of increments, robust to undetermined ones, which may be anything."""
    if not len(increments):
        return 0.0
    usual = float(robust_sd(increments))
    return usual if usual > 0 else float(np.sqrt(np.mean(increments**2)))
