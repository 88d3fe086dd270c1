"""R of a tall matrix that comes in blocks of rows: the memory of one block, the accuracy of Householder's QR.

Normal equations would square a condition number that is large here, because neighbouring plays are nearly
collinear. (Demmel, Grigori, Hoemmen and Langou, SIAM J. Sci. Comput. 34, 2012, call it TSQR.)
"""

import numpy as np
from scipy.linalg.lapack import dtpqrt, dtrtrs

PANEL = 4  # columns at a time: the quickest for 10 to 40 columns


class ThinQR:
    """Write into what `rows` gives and call `absorb` with it; `triangle` is R of all so far.

    Args:
        columns: Of the matrix.
        block: The most rows at once.
    """

    def __init__(self, columns: int, block: int) -> None:
        # In LAPACK's order.
        self.triangle = np.zeros((columns, columns), order="F")  # upper; the signs of its rows are arbitrary
        self.memory = np.empty(columns * block)
        self.panel = min(PANEL, columns)

    def rows(self, count: int) -> np.ndarray:
        """Room for so many rows, contiguous: LAPACK works in place. Shape: (count, columns)."""
        columns = len(self.triangle)
        return self.memory[: count * columns].reshape((count, columns), order="F")

    def absorb(self, rows: np.ndarray) -> None:
        dtpqrt(0, self.panel, self.triangle, rows, overwrite_a=True, overwrite_b=True)


def triangle_of(matrix: np.ndarray) -> np.ndarray:
    """R of a matrix. Shape: (columns, columns)."""
    factor = ThinQR(matrix.shape[1], len(matrix))
    rows = factor.rows(len(matrix))
    rows[:] = matrix
    factor.absorb(rows)
    return factor.triangle


def solve_triangle(triangle: np.ndarray, target: np.ndarray) -> np.ndarray:
    """x of R x = target, for an upper triangle without a zero on its diagonal."""
    solution, _ = dtrtrs(triangle, target)
    return np.asarray(solution)
