"""R of a tall matrix that comes in blocks of rows: the memory of one block, the accuracy of Householder's QR.

Normal equations would square a condition number that is large here, because neighbouring plays are nearly
collinear. (Demmel, Grigori, Hoemmen and Langou, SIAM J. Sci. Comput. 34, 2012, call it TSQR.)
"""

from functools import cache

import numpy as np
from scipy.linalg.lapack import dgeqrf, dtrtrs


class ThinQR:
    """Write rows into `rows` and call `absorb` with their number; `triangle` is R of all so far.

    Args:
        columns: Of the matrix.
        block: The most rows at once.
    """

    def __init__(self, columns: int, block: int) -> None:
        self.columns = columns
        # In LAPACK's order: R of the rows before on top, new rows below.
        self.buffer = np.zeros((columns + block, columns), order="F")
        self.triangle = self.buffer[:columns]  # upper triangular; the signs of its rows are arbitrary
        self.rows = self.buffer[columns:]

    def absorb(self, count: int) -> None:
        # In place where the block is full, or else in a copy.
        factored, *_ = dgeqrf(self.buffer[: self.columns + count], lwork=64 * self.columns, overwrite_a=True)
        self.triangle[:] = factored[: self.columns]
        self.triangle[_below_diagonal(self.columns)] = 0.0


@cache
def _below_diagonal(columns: int) -> tuple[np.ndarray, np.ndarray]:
    return np.tril_indices(columns, -1)


def triangle_of(matrix: np.ndarray) -> np.ndarray:
    """R of a matrix with at least as many rows as columns. Shape: (columns, columns)."""
    columns = matrix.shape[1]
    factored, *_ = dgeqrf(matrix, lwork=64 * columns)
    triangle: np.ndarray = np.triu(factored[:columns])
    return triangle


def solve_triangle(triangle: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """x of R x = wanted, for an upper triangle without a zero on its diagonal."""
    solution, _ = dtrtrs(triangle, wanted)
    return np.asarray(solution)
