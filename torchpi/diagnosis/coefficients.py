"""The Haar coefficients of one recording over which a fit sums, and the cell that each belongs to."""

from dataclasses import dataclass

import numpy as np

from torchpi.diagnosis.haar import CELLS, Haar
from torchpi.diagnosis.repeats import PLAIN, Repeats

CHUNK = 16
"""Number of rows whose non-repeating part is computed at a time."""


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Coefficients of a recording's readings and, where its input repeats, of their non-repeating part.

    They are in the order of the stretches of time in which they lie; there are as many as cells on one scale.
    The part that follows the voltage counts once; the part that does not counts again, free of what masks it.
    """

    samples: int
    """Number of samples that are transformed: those before the sealed block."""
    repeats: Repeats
    pieces: tuple[tuple[int, Haar, np.ndarray], ...]
    """First sample and transform of each piece, and the places of its coefficients among all, (its own,); the
    first piece has the readings as they are."""
    ends: np.ndarray  # shape: (CELLS + 1,), where the coefficients of each stretch of time begin, and end
    scale: np.ndarray  # shape: (kept,), number of samples that each spans
    cell: np.ndarray  # shape: (kept,), numbered within the recording
    at: np.ndarray  # shape: (kept,), the sample in the middle of each
    level_of_cell: np.ndarray  # shape: (cells,), 1 for differences of neighbours
    kind_of_cell: np.ndarray  # shape: (cells,), the kind of its piece

    @classmethod
    def of(
        cls, u: np.ndarray, activity: np.ndarray, samples: int, valid: np.ndarray, at_most: int
    ) -> "Coefficients":
        """Choose the coefficients of a recording.

        Args:
            u: (time,), its voltage.
            activity: (time,), a signal whose larger coefficients are kept first where not all can be.
            samples: How many samples, from the first, are transformed.
            valid: (time,), bool: readings that count.
            at_most: Maximum number of coefficients kept on one scale of a piece.
        """
        repeats = Repeats.of(u, samples, valid)
        active = repeats(activity[None])[0]
        pieces, kinds = [(0, Haar.of(activity, samples, valid, at_most))], [PLAIN]
        for first, stop, kind in repeats.pieces:
            haar = Haar.of(active[first:stop], stop - first, repeats.apart[first:stop], at_most)
            if len(haar.kept):
                pieces.append((first, haar))
                kinds.append(kind)
        first_cell = np.cumsum([0, *(haar.cells for _, haar in pieces)])
        at = np.concatenate([haar.at + first for first, haar in pieces])
        stretch = at * CELLS // samples
        order = np.argsort(stretch, kind="stable")
        places = np.split(np.argsort(order), np.cumsum([len(haar.kept) for _, haar in pieces])[:-1])
        return cls(
            samples,
            repeats,
            tuple((first, haar, place) for (first, haar), place in zip(pieces, places, strict=True)),
            np.searchsorted(stretch[order], np.arange(CELLS + 1)),
            np.concatenate([2.0 ** np.minimum(haar.level, haar.levels) for _, haar in pieces])[order],
            np.concatenate([haar.cell + k for (_, haar), k in zip(pieces, first_cell, strict=False)])[order],
            at[order],
            np.concatenate([haar.level_of_cell for _, haar in pieces]),
            np.repeat(kinds, [haar.cells for _, haar in pieces]),
        )

    @property
    def kept(self) -> int:
        return len(self.cell)

    @property
    def cells(self) -> int:
        return len(self.level_of_cell)

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """(rows, kept): the coefficients of rows, (rows, time)."""
        (_, readings, places), *apart = self.pieces
        out = np.empty((len(rows), self.kept))
        readings.write(rows, out, places)
        for begin in range(0, len(rows) if apart else 0, CHUNK):
            some = slice(begin, begin + CHUNK)
            left = self.repeats(rows[some])
            for first, haar, places in apart:
                part = np.ascontiguousarray(left[:, first : first + haar.samples])
                haar.write(part, out[some], places)
        return out
