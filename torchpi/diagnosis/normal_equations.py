"""Normal equations of numbers in any units, and the elimination of some of these numbers."""

import numpy as np
from scipy.linalg.lapack import dposv

RIDGE = 1e-9
"""Added to a unit diagonal, so that nearly equal rows can be solved for."""
NOTHING = 1e-150
"""Diagonal below which a number affects no reading: it has no natural scale, and absorbs nothing."""


def to_unit_diagonal(gram: np.ndarray, ridge: float = RIDGE) -> tuple[np.ndarray, np.ndarray]:
    """Scale inner products, (numbers, numbers), to a unit diagonal, and add a ridge to it.

    Returns:
        The scaled inner products, and the scale of each number, (numbers,); 0 for one without effect.
    """
    size = np.diag(gram)
    scale = np.where(size > NOTHING, 1 / np.sqrt(np.maximum(size, NOTHING)), 0.0)
    unit: np.ndarray = gram * scale * scale[:, None]
    unit[np.diag_indices_from(unit)] += ridge
    return unit, scale


def solve(
    gram: np.ndarray,
    right: np.ndarray,
    first: int | None = None,
    damping: float = 0.0,
    ridge: float = RIDGE,
) -> np.ndarray:
    """Return the step of the normal equations, (numbers,); that of the numbers from `first` on is damped."""
    unit, scale = to_unit_diagonal(gram, ridge)
    damped = np.arange(len(unit) if first is None else first, len(unit))
    unit[damped, damped] += damping
    step: np.ndarray = np.linalg.solve(unit, right * scale) * scale
    return step


def solve_positive(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a positive definite system by Cholesky's method, or by elimination where it is only nearly so."""
    _, found, failed = dposv(matrix.T, right)  # in the order of columns that LAPACK reads
    solved: np.ndarray = np.linalg.solve(matrix, right) if failed else found
    return solved


def without_others(information: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the information on some of the numbers, (places, places), when the others are eliminated."""
    others = np.setdiff1d(np.arange(len(information)), places)
    pairs = ((places, places), (places, others), (others, others))
    return eliminated(*(information[np.ix_(*pair)] for pair in pairs))


def eliminated(information: np.ndarray, across: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the information on numbers, (numbers, numbers), after others are eliminated: the Schur
    complement of theirs, (others, others), with `across`, (numbers, others)."""
    left: np.ndarray = information - across @ np.linalg.solve(others, across.T)
    return left
