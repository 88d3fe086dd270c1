"""R of a tall matrix, block of rows by block: the memory of one block, the accuracy of Householder's QR.

Normal equations would square a condition number that is large here, because neighbouring plays are nearly
collinear. (Demmel, Grigori, Hoemmen and Langou, SIAM J. Sci. Comput. 34, 2012, call it TSQR.)
"""

import numpy as np
from scipy.linalg.lapack import dtpqrt, dtrtrs

PANEL = 4  # columns at a time: fastest for 10 to 40 columns


class ThinQR:
    """Write into the array from `rows` and pass it to `absorb`; `triangle` is R of all rows so far.

    Args:
        columns: Number of columns of the matrix.
        block: Maximum number of rows at once.
    """

    def __init__(self, columns: int, block: int) -> None:
        # Stored in LAPACK's order.
        self.triangle = np.zeros((columns, columns), order="F")  # upper; the signs of its rows are arbitrary
        self.memory = np.empty(columns * block)
        self.panel = min(PANEL, columns)

    def rows(self, count: int) -> np.ndarray:
        """Return contiguous space for `count` rows, since LAPACK works in place. Shape: (count, columns)."""
        columns = len(self.triangle)
        return self.memory[: count * columns].reshape((count, columns), order="F")

    def absorb(self, rows: np.ndarray) -> None:
        dtpqrt(0, self.panel, self.triangle, rows, overwrite_a=True, overwrite_b=True)


def triangle_of(matrix: np.ndarray) -> np.ndarray:
    """Return R of a matrix. Shape: (columns, columns)."""
    factor = ThinQR(matrix.shape[1], len(matrix))
    rows = factor.rows(len(matrix))
    rows[:] = matrix
    factor.absorb(rows)
    return factor.triangle


def solve_triangle(triangle: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Solve R x = target for x, with an upper triangle R without a zero on its diagonal."""
    solution, _ = dtrtrs(triangle, target)
    return np.asarray(solution)
