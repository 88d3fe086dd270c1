"""The prior of a random walk: its increments have one size, also where no reading tells where it is.

Knots behind the last reading that is fitted, and between recordings of different lengths, are determined by
nothing else: without the prior a walk ends anywhere. The size is that of the increments with which a fit
begins (empirical Bayes: Efron and Morris, *J. American Statistical Association* 68, 1973).
"""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.hypothesis import FreeParameter, Hypothesis
from torchpi.recordings.faults import robust_sd


def walk_prior(hypothesis: Hypothesis, slots: Sequence[FreeParameter], theta: np.ndarray) -> np.ndarray:
    """(slots, slots): the inverse covariance of the slots, 0 for all that are not on a walk.

    Args:
        hypothesis: With the effects.
        slots: Its free parameters.
        theta: (slots,), their values on the scale that they are fitted on.
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
    """(knots, slots): the increments of one walk, from 0 on, as combinations of the slots."""
    values = np.zeros((len(knots) + 1, len(slots)))
    for row, j in enumerate(knots, 1):
        values[row, j] = slots[j].scale
    return np.diff(values, axis=0)


def _size(increments: np.ndarray) -> float:
    """The standard deviation of increments of which some are told by nothing, and may be anything."""
    if not len(increments):
        return 0.0
    usual = float(robust_sd(increments))
    return usual if usual > 0 else float(np.sqrt(np.mean(increments**2)))
