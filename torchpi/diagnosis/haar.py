"""Residuals and sensitivities as Haar coefficients: one noise level for each time scale and stretch of time.

The coefficients of noise of any colour from white to 1/f² are nearly independent, with a separate variance
on each scale (Wornell and Oppenheim, *Wavelet-based representations for a class of self-similar signals*,
IEEE Trans. Information Theory 38(2), 1992). Ringing over 40 ms and creep over minutes appear in different
coefficients, so neither outweighs the other.
"""

from dataclasses import dataclass
from math import sqrt

import numba
import numpy as np

COARSEST = 16
"""Minimum number of coefficients on the slowest scale."""
CELLS = 24
"""Maximum number of cells in time into which one scale of one recording is cut."""
LEAST_IN_CELL = 4
"""Minimum number of coefficients in a cell."""


@dataclass(frozen=True, eq=False)
class Haar:
    """The coefficients of one recording that a fit sums over, and the cell that each belongs to."""

    samples: int
    """Number of samples that are transformed: those before the sealed block."""
    levels: int
    valid: np.ndarray  # shape: (samples,), 1.0, or 0.0 for an excluded reading
    kept: np.ndarray  # shape: (kept,), places in the full transform
    level: np.ndarray  # shape: (kept,), 1 for differences of neighbours; levels + 1 for the remaining sums
    cell: np.ndarray  # shape: (kept,), numbered within the recording
    at: np.ndarray  # shape: (kept,), the sample in the middle of each

    @classmethod
    def of(cls, activity: np.ndarray, samples: int, valid: np.ndarray, at_most: int) -> "Haar":
        """Set up the transform of a recording.

        Args:
            activity: (time,), a signal; where not all coefficients can be kept, its largest are preferred.
            samples: How many samples, from the first, are transformed.
            valid: (time,), bool: readings that count.
            at_most: Maximum number of coefficients kept on one scale.
        """
        levels = max(0, int(np.log2(max(samples // COARSEST, 1))))
        mask = valid[:samples].astype(np.float64)
        nothing = np.zeros(0, int)
        whole = cls(samples, levels, mask, nothing, nothing, nothing, nothing)
        size = np.abs(whole.full(activity[None, :samples])[0])
        support = whole.support()
        kept, level, cell, at, cells = [], [], [], [], 0
        for one in range(1, levels + 2):
            first, stop = whole.places(one)
            width = 2 ** min(one, levels)
            there = first + np.flatnonzero(support[first:stop] > 0.5)
            if len(there) > at_most:
                there = np.union1d(
                    there[:: -(-len(there) // (at_most // 2))],
                    there[np.sort(np.argsort(-size[there], kind="stable")[: at_most // 2])],
                )
            if not len(there):
                continue
            count = max(1, min(CELLS, len(there) // LEAST_IN_CELL))
            kept.append(there)
            level.append(np.full(len(there), one))
            cell.append(cells + np.arange(len(there)) * count // len(there))
            at.append(np.minimum((there - first) * width + width // 2, samples - 1))
            cells += count
        joined = (np.concatenate(part or [nothing]) for part in (kept, level, cell, at))
        return cls(samples, levels, mask, *joined)

    @property
    def cells(self) -> int:
        return int(self.cell[-1]) + 1

    @property
    def level_of_cell(self) -> np.ndarray:
        """The level of each cell, (cells,)."""
        found = np.zeros(self.cells, dtype=int)
        found[self.cell] = self.level
        return found

    def places(self, level: int) -> tuple[int, int]:
        """Return where the coefficients of a level begin and end in the full transform."""
        coarsest = -(-self.samples // 2**self.levels)
        return (
            (0, coarsest)
            if level > self.levels
            else (coarsest * 2 ** (self.levels - level), coarsest * 2 ** (self.levels - level + 1))
        )

    def write(self, rows: np.ndarray, out: np.ndarray, columns: np.ndarray) -> None:
        """Write the kept coefficients of rows, (rows, time), to columns, (kept,), of `out`, (rows, …)."""
        _kept(rows, self.valid, self.levels, self.kept, columns, out)

    def full(self, rows: np.ndarray) -> np.ndarray:
        """Return all coefficients, (rows, coefficients), the slowest first, of rows, (rows, time)."""
        size = -(-self.samples // 2**self.levels) * 2**self.levels
        out = np.empty((len(rows), size))
        _kept(rows, self.valid, self.levels, np.arange(size), np.arange(size), out)
        return out

    def support(self) -> np.ndarray:
        """Return the share of valid samples under each coefficient, (coefficients,)."""
        size = -(-self.samples // 2**self.levels) * 2**self.levels
        count = np.zeros(size)
        count[: self.samples] = self.valid
        share = np.empty(size)
        for level in range(1, self.levels + 1):
            count = count.reshape(-1, 2).mean(1)
            first, stop = self.places(level)
            share[first:stop] = count
        share[: len(count)] = count
        return share


@numba.njit(cache=True)
def _kept(
    rows: np.ndarray, valid: np.ndarray, levels: int, kept: np.ndarray, columns: np.ndarray, out: np.ndarray
) -> None:
    samples = len(valid)
    size = -(-samples // 2**levels) * 2**levels
    full, root = np.empty(size), 1.0 / sqrt(2.0)
    sums, coarser = np.zeros(size), np.empty(size // 2 + 1)
    for i in range(len(rows)):
        for t in range(samples):
            sums[t] = rows[i, t] * valid[t]
        sums[samples:] = 0.0
        n, finer, next_ = size, sums, coarser
        for _ in range(levels):
            n //= 2
            for k in range(n):
                first, second = finer[2 * k], finer[2 * k + 1]
                next_[k] = (first + second) * root
                full[n + k] = (second - first) * root
            finer, next_ = next_, finer
        full[:n] = finer[:n]
        for k in range(len(kept)):
            out[i, columns[k]] = full[kept[k]]
