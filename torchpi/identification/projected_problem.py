"""Variable projection: the least-squares problem that remains once the weights are solved for.

Golub and Pereyra (1973), with the part of their derivative that Kaufman (1975) keeps. For every α the voltage
is linear in β, so min_β |Φ(α) β - u|² is a function of α alone, and its linearisation is P (u - D δ) with
D = d(Φβ)/dα at the best β and P the projector orthogonal to the columns of Φ. One QR factorisation of
(Φ, D, u) gives all of it: R = ((R_11, R_12, r_13), (0, R_22, r_23), (0, 0, ρ)) yields β = R_11⁻¹ r_13, the
step δ = argmin |R_22 δ - r_23|, and the least |Φβ - u|² = |r_23|² + ρ².
"""

import copy
from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification.inverse_columns import InverseColumns, RateFunctions
from torchpi.identification.inverse_rows import Nonlinear, Record, Stretch, blocks
from torchpi.identification.pair import InversePair
from torchpi.identification.thin_qr import ThinQR, solve_triangle, triangle_of

# A play of threshold r moves over the range of S less 2 r, and stands still on the rest. One that stands
# still on more than this share of the range is an offset, which the first loading sets anew in each record.
STANDS_AT_MOST = 0.6
POSITIONS = 65  # over the recorded range, at which S is evaluated
# Without a ridge, this keeps the triangle invertible where a play that never moved leaves a zero column.
FLOOR = 1e-10


class Solved(NamedTuple):
    """The best weights at one α."""

    objective: float  # V²: mean square with the ridge, the quantity minimised
    mean_square: float  # V²: of the voltage error alone
    beta: np.ndarray  # (columns,)


class Linearised(NamedTuple):
    """The projected problem linearised at one α: |slopes · δ - error|² per sample, plus what no δ reduces."""

    slopes: np.ndarray  # R_22: (searched, searched)
    error: np.ndarray  # r_23: (searched,)


class ProjectedProblem:
    """The problem that fits of a direct inverse minimise over α, from the state of `compensator`.

    Args:
        compensator: Read here, and written only by `put`.
        pairs: Records, of any lengths.
        searched: Names of the parts of α that are searched, as in `Nonlinear`; a threshold of 0 never is.
        functions: Number of rate functions that the weights have: the first few, or all.
        own_degree: Number of columns of each play's own output function beyond the weighted sum.
        ridge: Share of the columns' mean square that is added to the diagonal, to keep the weights bounded in
            directions that no record determines.
        rows: Ascending indices of the samples of each record that are fitted; by default those that count.
            The others only set the states. A record without any is left out.
    """

    def __init__(
        self,
        compensator: DirectInverse,
        pairs: Sequence[InversePair],
        searched: Sequence[str],
        functions: int,
        own_degree: int,
        ridge: float = 0.0,
        rows: Sequence[np.ndarray] | None = None,
    ) -> None:
        self.compensator = compensator
        self.ridge = ridge
        self.columns = InverseColumns(compensator, functions, own_degree)
        self.decay = compensator.creep_decay.numpy().copy()
        self.rate_scale_um_s = float(compensator.weights.rate_scale_um_s)

        start = nonlinear(compensator)
        lengths = [len(part) for part in start]
        ends = np.cumsum(lengths)
        self.parts = [slice(end - length, end) for end, length in zip(ends, lengths, strict=True)]
        self.numbers = np.concatenate(start)
        self.lead = start.lead
        names = np.repeat(start._fields, lengths)
        # A play with threshold 0 copies its input, and is not searched.
        free = [
            name in searched and (name != "r" or r > 0) for name, r in zip(names, self.numbers, strict=True)
        ]
        self.searched = np.flatnonzero(free)
        names = names[self.searched]
        self.is_threshold = names == "r"
        self.is_polynomial = names == "c"
        self.moves_rate = "slope" in names or "shift" in names
        # If the lead is searched, the turning points of the input change with it.
        self.needs_every_sample = bool(start.gains.any()) or "gains" in names or "lead" in names
        counted = torch.cat([pair.motion.yd[0, pair.counted] for pair in pairs])
        self.y = np.linspace(float(counted.min()), float(counted.max()), POSITIONS)
        self.stands_at_most = np.inf
        every = [Record.of(pair) for pair in pairs]
        if rows is not None:
            every = [one.with_rows(kept) for one, kept in zip(every, rows, strict=True) if len(kept) > 0]
        self._take(every)

    def _stands(self, part: Nonlinear) -> float:
        """Return the share of the range of S on which the widest play stands still."""
        s = np.polynomial.polynomial.polyval(self.y, np.append(0.0, part.c))
        return float(2 * part.r.max() / max(np.ptp(s), np.finfo(float).tiny))

    def _take(self, records: list[Record]) -> None:
        self.records = records
        self.samples = sum(len(record.counted) for record in records)
        self.stretches = [record.stretches() for record in records]
        self.most_rows = max(len(part.rows) for record in self.stretches for part in record)
        start = self._nonlinear_at(self.numbers[self.searched])
        # These are constant unless the neural head is searched.
        self.rates = [[self._rate(part, start) for part in record] for record in self.stretches]

    @property
    def alpha(self) -> np.ndarray:
        """Starting α, that of the compensator. Shape: (searched,)."""
        return self.numbers[self.searched]

    def bounded(self) -> "ProjectedProblem":
        """Return the same problem without the scales of S at which the widest play hardly moves.

        Wider thresholds that a user has chosen stay allowed, with a small margin; free ones are not bounded.
        """
        own = np.inf if self.is_threshold.any() else 1.05 * self._stands(self._nonlinear_at(self.alpha))
        bounded = copy.copy(self)
        bounded.stands_at_most = max(STANDS_AT_MOST, own)
        return bounded

    def thinned(self, rows: int) -> Self:
        """Return the same problem with about this many rows, evenly spread, or with all if they are fewer."""
        step = self.samples // rows
        if step < 2:
            return self
        thinned = copy.copy(self)
        thinned._take(
            [
                record.fewer_rows(step) if self.needs_every_sample else record.fewer_samples(step, self.lead)
                for record in self.records
            ]
        )
        return thinned

    def moved(self, alpha: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return `alpha + step` with positive thresholds: no step reduces one below a tenth of its value."""
        trial: np.ndarray = np.where(self.is_threshold, np.maximum(alpha + step, 0.1 * alpha), alpha + step)
        return trial

    def solve(self, alpha: np.ndarray) -> Solved:
        """Return the best weights at α; the objective is infinite where a bounded problem excludes α."""
        if self._stands(self._nonlinear_at(alpha)) > self.stands_at_most:
            return Solved(np.inf, np.inf, np.zeros(self.columns.count))
        triangle, _ = self._factor(alpha, None)
        p, samples = self.columns.count, self.samples
        if self.ridge == 0:
            mean_square = float(triangle[p, p] ** 2) / samples
            return Solved(mean_square, mean_square, solve_triangle(triangle[:p, :p], triangle[:p, p]))
        reduced, size = self._with_ridge(triangle, None)
        beta = solve_triangle(reduced[:p, :p], reduced[:p, p]) / size
        left = triangle[:, :p] @ beta - triangle[:, p]
        return Solved(float(reduced[p, p] ** 2) / samples, float(left @ left) / samples, beta)

    def linearise(self, alpha: np.ndarray, beta: np.ndarray) -> Linearised:
        """Linearise the projected error in α; `beta` is the best there."""
        triangle, products = self._factor(alpha, beta)
        if products is not None:
            triangle, _ = self._with_ridge(triangle, products)
        p, end, root = self.columns.count, self.columns.count + len(self.searched), np.sqrt(self.samples)
        return Linearised(triangle[p:end, p:end] / root, triangle[p:end, end] / root)

    def put(self, alpha: np.ndarray, beta: np.ndarray) -> None:
        """Write α and β into the compensator; weights that have no column become 0."""
        part = self._nonlinear_at(alpha)
        theta, psi = self.columns.weights(beta)
        compensator, weights = self.compensator, self.compensator.weights
        powers = compensator.sample_period_s ** np.arange(1, len(part.lead) + 1)
        with torch.no_grad():
            compensator.scaled_lead.copy_(torch.from_numpy(part.lead / powers))
            compensator.creep_gains.copy_(torch.from_numpy(part.gains))
            compensator.saturation.set_coefficients(torch.from_numpy(part.c))
            compensator.plays.raw_thresholds.copy_(torch.from_numpy(part.r))
            weights.slope.copy_(torch.from_numpy(part.slope))
            weights.shift.copy_(torch.from_numpy(part.shift))
            weights.theta.zero_()
            weights.theta[:, : theta.shape[1]] = torch.from_numpy(theta)
            compensator.psi.zero_()
            compensator.psi[:, : psi.shape[1]] = torch.from_numpy(psi)
            if self.columns.has_offset:
                compensator.offset.fill_(float(beta[-1]))

    def _factor(
        self,
        alpha: np.ndarray,
        beta: np.ndarray | None,  # (columns,)
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """R of (Φ, D, u), or (Φ, u) without β; for a ridge also β_j Φ_jᵀ ∂Φ_j/∂α_k, (columns, searched)."""
        part, columns = self._nonlinear_at(alpha), self.columns
        p = columns.count
        factor = ThinQR(p + 1 + (0 if beta is None else len(self.searched)), self.most_rows)
        if self.ridge == 0:
            factor.triangle[np.diag_indices(p)] = FLOOR * columns.range_um * np.sqrt(self.samples)
        slopes = None if beta is None or self.ridge == 0 else np.zeros((p, len(self.numbers)))
        for one, record, rates in zip(self.records, self.stretches, self.rates, strict=True):
            ran = blocks(record, part, self.decay, derivative=beta is not None)
            for stretch, block, kept in zip(record, ran, rates, strict=True):
                rate = self._rate(stretch, part) if self.moves_rate else kept
                rows = factor.rows(len(block.h))
                columns.fill(rows, block.h, rate.phi)
                rows[:, -1] = stretch.u
                if beta is not None:
                    rows[:, p:-1] = columns.derivative(block, rate, beta, self.searched)
                if slopes is not None:
                    slopes += one.weight * columns.size_slopes(block, rate, len(self.numbers))
                rows *= np.sqrt(one.weight)
                factor.absorb(rows)
        if slopes is None or beta is None:
            return factor.triangle, None
        return factor.triangle, slopes[:, self.searched] * beta[:, None]

    def _rate(self, part: Stretch, at: Nonlinear) -> RateFunctions:
        return RateFunctions(part.rate, at, self.rate_scale_um_s, self.columns.functions)

    def _with_ridge(self, triangle: np.ndarray, products: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return R with extra rows √ridge · size_j · β_j, its columns scaled to size 1, and their sizes."""
        p, every = self.columns.count, len(triangle)
        size = np.sqrt(np.square(triangle[:, :p]).sum(0) / self.samples)
        size[size == 0] = 1.0  # a play that never moved
        weight = np.sqrt(self.ridge * self.samples)
        both = np.zeros((every + p, every))
        both[:every] = triangle
        both[:every, :p] /= size
        both[every + np.arange(p), np.arange(p)] = weight
        if products is not None:
            both[every:, p:-1] = weight * products / (self.samples * size[:, None])
        return triangle_of(both), size

    def _nonlinear_at(self, alpha: np.ndarray) -> Nonlinear:
        numbers = self.numbers.copy()
        numbers[self.searched] = alpha
        return Nonlinear(*(numbers[part] for part in self.parts))


def nonlinear(compensator: DirectInverse) -> Nonlinear:
    """Return the current α of a compensator."""
    parts = (
        compensator.lead,
        compensator.creep_gains,
        compensator.saturation.c,
        compensator.plays.r,
        compensator.weights.slope,
        compensator.weights.shift,
    )
    return Nonlinear(*(part.detach().numpy().copy() for part in parts))
