"""The search for α: rough first, from several scales of the polynomial, then on every row.

The thresholds alone fix the scale of S against the weights. As it grows one play after the other begins to
move, and each leaves a kink in the objective: there are several minima, of which a descent finds the next.
"""

import numpy as np

from torchpi.identification.levenberg_marquardt import levenberg_marquardt
from torchpi.identification.projected_problem import ProjectedProblem, Solved

ROWS_PER_NUMBER = 20  # enough to tell minima apart
FACTORS = 2.0 ** (np.arange(-16, 17) / 8)  # of the scale of S
STARTS = 3
FEW = 12  # trials of a start
FINALISTS = 3  # of a thorough search
ROUGH, FINE = 1e-2, 1e-4  # tolerances


def search(problem: ProjectedProblem, evaluations: int, thorough: bool = False) -> tuple[np.ndarray, Solved]:
    """The best α that was found, and the weights there.

    Args:
        problem: What is minimised, from where its compensator stands.
        evaluations: The most trials of one descent.
        thorough: Descend on every row from several of the rough minima, and from the start itself, instead
            of from the best one: where much is searched, what is best on some rows need not be on all.
    """
    rough = problem.thinned(ROWS_PER_NUMBER * (problem.columns.count + len(problem.searched)))
    found = [levenberg_marquardt(rough, problem.alpha, evaluations, ROUGH)]
    if problem.is_polynomial.any():
        starts = _starts(rough, found[0][0])
        found += [levenberg_marquardt(rough, start, min(FEW, evaluations), ROUGH) for start in starts]
    found.sort(key=_objective)
    finalists = [alpha for alpha, _ in found[: FINALISTS if thorough else 1]]
    if thorough:
        finalists.append(problem.alpha)
    return min((levenberg_marquardt(problem, each, evaluations, FINE) for each in finalists), key=_objective)


def _objective(found: tuple[np.ndarray, Solved]) -> float:
    return found[1].objective


def _starts(problem: ProjectedProblem, alpha: np.ndarray) -> list[np.ndarray]:
    """The deepest minima along the scale of S, without the one that `alpha` is in."""
    scaled = [np.where(problem.is_polynomial, factor * alpha, alpha) for factor in FACTORS]
    height = np.array([problem.solve(each).objective for each in scaled])
    around = np.concatenate([[np.inf], height, [np.inf]])
    lowest = np.flatnonzero((height <= around[:-2]) & (height <= around[2:]))
    here = len(FACTORS) // 2
    others = [i for i in lowest[np.argsort(height[lowest])] if abs(i - here) > 1]
    return [scaled[i] for i in others[:STARTS]]
