"""Search for α: coarsely from several scales of the polynomial first, then on every row.

Only the thresholds fix the scale of S relative to the weights. As that scale grows, one play after another
begins to move, and each leaves a kink in the objective. There are therefore several minima, and a descent
finds the nearest. The deepest may lie where the widest plays hardly move, which fits one loop a little better
and every other loop worse (`projected_problem.STANDS_AT_MOST`): such scales are excluded.
"""

import numpy as np

from torchpi.identification.levenberg_marquardt import levenberg_marquardt
from torchpi.identification.projected_problem import ProjectedProblem, Solved

ROWS_PER_NUMBER = 20  # enough to tell minima apart
FACTORS = 2.0 ** (np.arange(-16, 17) / 8)  # trial factors on the scale of S
STARTS = 3
FEW = 12  # most trials of a descent from another scale
FINALISTS = 3  # rough minima that a thorough search refines
ROUGH, FINE = 1e-2, 1e-4  # tolerances


Found = tuple[np.ndarray, Solved]  # α, and the best weights there


def search(problem: ProjectedProblem, evaluations: int, thorough: bool = False) -> Found:
    """Return the best α found, and the weights there.

    Args:
        problem: The problem to minimise, starting from the state of its compensator.
        evaluations: Maximum number of trials of one descent.
        thorough: Descend on every row from several of the rough minima, and from the start itself if its own
            rough minimum is not the deepest: with many searched parameters, the best α on some rows need not
            be the best on all.
    """
    problem = problem.bounded()
    rough = problem.thinned(ROWS_PER_NUMBER * (problem.columns.count + len(problem.searched)))
    own = levenberg_marquardt(rough, problem.alpha, evaluations, ROUGH)
    found = [own]
    if problem.is_polynomial.any():
        for start in _starts(rough, own[0]):
            least = min(found, key=_objective)[1].objective
            found.append(levenberg_marquardt(rough, start, min(FEW, evaluations), ROUGH, least))
    found.sort(key=_objective)
    best = levenberg_marquardt(problem, found[0][0], evaluations, FINE)
    if not thorough:
        return best
    for alpha, _ in found[1:FINALISTS]:
        rival = levenberg_marquardt(problem, alpha, evaluations, FINE, best[1].objective)
        best = min(best, rival, key=_objective)
    if found[0] is not own or problem.solve(problem.alpha).objective < best[1].objective:
        best = min(best, descend(problem, evaluations), key=_objective)
    return best


def descend(problem: ProjectedProblem, evaluations: int) -> Found:
    """Descend from the start to the nearest minimum."""
    return levenberg_marquardt(problem, problem.alpha, evaluations, FINE)


def _objective(found: Found) -> float:
    return found[1].objective


def _starts(problem: ProjectedProblem, alpha: np.ndarray) -> list[np.ndarray]:
    """Return the deepest minima along the scale of S, except the one around `alpha`."""
    scaled = [np.where(problem.is_polynomial, factor * alpha, alpha) for factor in FACTORS]
    height = np.array([problem.solve(each).objective for each in scaled])
    around = np.concatenate([[np.inf], height, [np.inf]])
    lowest = np.flatnonzero((height <= around[:-2]) & (height <= around[2:]) & np.isfinite(height))
    here = len(FACTORS) // 2
    others = [i for i in lowest[np.argsort(height[lowest])] if abs(i - here) > 1]
    return [scaled[i] for i in others[:STARTS]]
