"""The projected least-squares problem, restricted to inverses that cannot run backwards.

The weights are expressed by sums over the plays sorted by threshold, at either end of the recorded rates,

    W_j(ẏ) = Σ_{i≤j} w_i(ẏ),   u = Σ_j W_j(ẏ) (h_j - h_{j+1}) + u_0,   W_j(ẏ_low), W_j(ẏ_high) ≥ W_least > 0

so that a non-negative least-squares problem (Lawson and Hanson, 1974) is solved at each α. Between these
rates, W_j is linear in ẏ and thus positive as well. S keeps S' ≥ S'_least over the recorded range, and rises
over it by as much as y, because only the thresholds fix its scale, and they are chosen for S(y) ≈ y.
Non-negativity also acts as a ridge would on neighbouring plays that are nearly collinear.
"""

import copy
from collections.abc import Sequence
from typing import Self

import numpy as np
import torch
from scipy.optimize import nnls

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification.pair import InversePair
from torchpi.identification.projected_problem import Linearised, ProjectedProblem, Solved
from torchpi.identification.projection import RIDGE
from torchpi.identification.thin_qr import triangle_of

LEAST_SLOPE = 1e-2  # least value of the sums, as a share of the records' volts per µm
LEAST_S_SLOPE = 0.1  # least value of S', which is about 1


class MonotoneProblem(ProjectedProblem):
    """The problem of form selection: lead, creep gains and polynomial are searched, the weights solved for.

    Args:
        compensator: Read here, and written only by `put`; without output functions of the plays, and with a
            rate head that is `none` or `linear`.
        pairs: Records, of any lengths.
        rows: As for `ProjectedProblem`.
    """

    def __init__(
        self,
        compensator: DirectInverse,
        pairs: Sequence[InversePair],
        rows: Sequence[np.ndarray] | None = None,
    ) -> None:
        functions = compensator.weights.theta.shape[1]
        super().__init__(compensator, pairs, ["lead", "gains", "c"], functions, own_degree=0, rows=rows)
        y, rate, u = (
            torch.cat([part[0, pair.counted] for pair, part in zip(pairs, parts, strict=True)])
            for parts in (
                [pair.motion.yd for pair in pairs],
                [pair.motion.yd_dot for pair in pairs],
                [pair.u for pair in pairs],
            )
        )
        self.range_um = min(0.0, float(y.min())), max(0.0, float(y.max()))
        falls = (
            float(torch.corrcoef(torch.stack([y, u]))[0, 1]) < -0.5
        )  # a sensor mounted the other way round
        slope = (-1.0 if falls else 1.0) * float(u.std() / y.std())
        self.to_weights = slope * self._of_sums(float(rate.min()), float(rate.max()))
        self.offset_columns = np.zeros((self.columns.count, 2 * self.columns.has_offset))
        self.offset_columns[-1:] = [1.0, -1.0][: self.offset_columns.shape[1]]
        # α of the search leaves out c_1, which follows from the others.
        first = int(np.flatnonzero(self.is_polynomial)[0])
        self.to_searched = np.eye(len(self.searched))
        low, high = float(y.min()), float(y.max())
        powers = np.arange(1, int(self.is_polynomial.sum()) + 1)
        self.to_searched[first, self.is_polynomial] = -(high**powers - low**powers) / (high - low)
        self.to_searched = np.delete(self.to_searched, first, 1)
        self.at_zero = np.zeros(len(self.searched))
        self.at_zero[first] = 1.0
        self.bending = np.zeros(len(self.searched) - 1)  # V, contribution of each number of α to the error

    def _of_sums(self, low: float, high: float) -> np.ndarray:
        """Return the map from sums W_j at one or both ends of the rates to θ: (columns, sums)."""
        plays, functions = self.columns.plays, self.columns.functions
        order = np.argsort(self.compensator.plays.r.detach().numpy())
        differences = np.zeros((plays, plays))  # from W to w
        differences[order] = np.eye(plays) - np.eye(plays, k=-1)
        if functions == 1:
            return np.pad(differences, ((0, int(self.columns.has_offset)), (0, 0)))
        low, high = low / self.rate_scale_um_s, high / self.rate_scale_um_s
        matrix = np.zeros((self.columns.count, 2 * plays))
        theta = matrix[: 2 * plays].reshape(plays, 2, 2 * plays)
        theta[:, 0] = np.hstack([high * differences, -low * differences]) / (high - low)
        theta[:, 1] = np.hstack([-differences, differences]) / (high - low)
        return matrix

    def stiffened(self, stiffness: float) -> Self:
        """Return the same problem with a ridge on the bend of S, Σ_{m≥2} (c_m range^(m-1))².

        Args:
            stiffness: Penalty of a sum of 1, as a share of the mean square error with S = y.
        """
        stiff = copy.copy(self)
        bends = np.delete(self.is_polynomial, int(np.argmax(self.at_zero)))
        left = self.solve(np.where(bends, 0.0, self.alpha)).mean_square if bends.any() else 0.0
        scales = self.compensator.range_um ** np.arange(1, bends.sum() + 1)
        stiff.bending = np.zeros(len(bends))
        stiff.bending[bends] = np.sqrt(stiffness * left) * scales
        return stiff

    @property
    def alpha(self) -> np.ndarray:
        """Starting α, that of the compensator, without c_1. Shape: (searched - 1,)."""
        return np.delete(super().alpha, int(np.argmax(self.at_zero)))

    def moved(self, alpha: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return `alpha + step`."""
        return np.asarray(alpha + step)

    def solve(self, alpha: np.ndarray) -> Solved:
        """Return the best weights at α; the objective is infinite if S is too flat somewhere, or falls."""
        searched = self._searched_at(alpha)
        if not self._rises(searched):
            return Solved(np.inf, np.inf, np.zeros(self.columns.count))
        triangle, _ = self._factor(searched, None)
        columns, left, sums = self._non_negative(self._with_rows_of_ridge(triangle))
        p = self.columns.count
        beta = self.to_weights.sum(1) * LEAST_SLOPE + np.hstack([self.to_weights, self.offset_columns]) @ sums
        error = triangle[:, :p] @ beta - triangle[:, p]
        objective = float(np.square(columns @ sums - left).sum()) / self.samples
        objective += float(np.square(self.bending * alpha).sum())
        return Solved(objective, float(error @ error) / self.samples, beta)

    def linearise(self, alpha: np.ndarray, beta: np.ndarray) -> Linearised:
        """Linearise the projected error in α while the sums that are at their bound stay there."""
        triangle, _ = self._factor(self._searched_at(alpha), beta)
        rows = self._with_rows_of_ridge(triangle)
        columns, left, sums = self._non_negative(rows)
        p, q = self.columns.count, int((sums > 0).sum())
        slopes = rows[:, p:-1] @ self.to_searched
        reduced = triangle_of(np.column_stack([columns[:, sums > 0], slopes, left]))
        end, root = q + len(alpha), np.sqrt(self.samples)
        bent = np.column_stack([np.diag(self.bending), -self.bending * alpha])
        both = triangle_of(np.vstack([reduced[q:end, q:] / root, bent]))
        return Linearised(both[: len(alpha), :-1], both[: len(alpha), -1])

    def put(self, alpha: np.ndarray, beta: np.ndarray) -> None:
        """Write α and β into the compensator."""
        super().put(self._searched_at(alpha), beta)

    def _searched_at(self, alpha: np.ndarray) -> np.ndarray:
        """Add c_1 such that S(high) - S(low) = high - low. Shape: (searched,)."""
        return np.asarray(self.at_zero + self.to_searched @ alpha)

    def _rises(self, searched: np.ndarray) -> bool:
        slope = np.polynomial.Polynomial(np.append(0.0, self._nonlinear_at(searched).c)).deriv()
        turns = [float(z.real) for z in slope.deriv().roots() if abs(z.imag) < 1e-9]
        low, high = self.range_um
        at = np.array([low, high, *(turn for turn in turns if low < turn < high)])
        return bool(slope(at).min() >= LEAST_S_SLOPE)

    def _with_rows_of_ridge(self, triangle: np.ndarray) -> np.ndarray:
        """Append the rows √ridge · size_j · β_j."""
        p = self.columns.count
        size = np.sqrt(np.square(triangle[:, :p]).sum(0))
        rows = np.zeros((len(triangle) + p, triangle.shape[1]))
        rows[: len(triangle)] = triangle
        rows[len(triangle) + np.arange(p), np.arange(p)] = np.sqrt(RIDGE) * size
        return rows

    def _non_negative(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return columns of the sums beyond their least and of ± offset, their target, and the best sums."""
        p = self.columns.count
        columns = rows[:, :p] @ np.hstack([self.to_weights, self.offset_columns])
        left = rows[:, -1] - LEAST_SLOPE * (rows[:, :p] @ self.to_weights.sum(1))
        size = np.linalg.norm(columns, axis=0)
        size[size == 0] = 1.0  # a play that never moved
        sums, _ = nnls(columns / size, left, maxiter=20 * len(size))
        return columns, left, sums / size
