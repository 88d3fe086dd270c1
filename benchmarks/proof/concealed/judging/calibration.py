"""Calibration of the stated probabilities: reliability, Brier score, calibration error.

Each name in an answer is taken with its probability. Names that the grader tolerates, or that the answer to
the untouched recording has as well, are neither right nor wrong and are left out. A name is right by itself
if it is the truth, or cannot be told apart from it by u and y; it is right as a group also if the truth is
among its alternatives.
"""

from collections.abc import Sequence

import numpy as np
from concealed.judging.proportions import share
from numpy.typing import NDArray

BINS = 10
DRAWS = 2000  # of a perfectly calibrated tool that states the same probabilities


def calibration(cases: Sequence[dict]) -> dict[str, object]:
    """Return both reliabilities over graded cases, each with its `stated` names."""
    stated = [name for case in cases for name in case["stated"]]
    judged = [name for name in stated if name["right"] is not None]
    known = [name for name in judged if name["probability"] is not None]
    probabilities = np.array([name["probability"] for name in known])
    return {
        "cases": len(cases),
        "names": len(known),
        "tolerated": len(stated) - len(judged),
        "without_a_probability": len(judged) - len(known),
        "by_itself": reliability(probabilities, np.array([bool(n["right"]) for n in known])),
        "as_a_group": reliability(probabilities, np.array([bool(n["right_group"]) for n in known])),
    }


def reliability(probabilities: NDArray[np.float64], right: NDArray[np.bool_]) -> dict[str, object]:
    """Brier score, expected calibration error, and the share that is right in each bin of probability.

    With few names the calibration error exceeds zero by chance alone: `by_chance` is its mean, and the value
    that 95 % stay below, for a tool that is right as often as it states.
    """
    if probabilities.size == 0:
        return {"brier": None, "expected_calibration_error": None, "by_chance": None, "bins": []}
    inside = np.minimum((probabilities * BINS).astype(int), BINS - 1)
    bins = [
        {
            "from": k / BINS,
            "to": (k + 1) / BINS,
            "probability": float(probabilities[inside == k].mean()),
            **share(int(right[inside == k].sum()), int(np.sum(inside == k))),
        }
        for k in range(BINS)
        if np.any(inside == k)
    ]
    chance = np.random.default_rng(0).random((DRAWS, probabilities.size)) < probabilities
    by_chance = _calibration_error(probabilities, chance, inside)
    return {
        "brier": float(np.mean((probabilities - right) ** 2)),
        "expected_calibration_error": float(_calibration_error(probabilities, right, inside)),
        "by_chance": {"mean": float(np.mean(by_chance)), "below": float(np.quantile(by_chance, 0.95))},
        "bins": bins,
    }


def _calibration_error(
    probabilities: NDArray[np.float64], right: NDArray[np.bool_], inside: NDArray[np.int_]
) -> NDArray[np.float64]:
    """Σ n_k / n |share that is right - mean probability| over the bins; `right` may be a stack of draws."""
    excess = (right - probabilities) @ (inside[:, None] == np.arange(BINS))
    return np.abs(excess).sum(axis=-1) / probabilities.size
