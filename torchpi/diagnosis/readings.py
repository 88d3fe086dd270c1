"""The readings of all recordings at the rate of the search, and which of them say nothing about the stage."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchpi.diagnosis.clock import MOST_SEEN, at_their_ticks
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.long_recordings import across_steps, at_a_lower_rate
from torchpi.diagnosis.records import SEALED, Record, not_counting, prepare
from torchpi.diagnosis.wrong_readings import wrong_readings
from torchpi.recordings.recording import Recording


@dataclass(frozen=True, eq=False)
class Readings:
    """Recordings as they were given, and as they are searched."""

    given: Sequence[Recording]
    recordings: Sequence[Recording]
    """The same, long ones at a lower rate."""
    out: Sequence[np.ndarray]
    """(readings,) for each recording: the indices of those that do not count."""
    across: Sequence[np.ndarray]
    """(readings,) for each recording: those among them that are means across a step of the voltage."""
    notes: tuple[str, ...]
    """Sentences on what was reduced."""

    @classmethod
    def of(cls, given: Sequence[Recording]) -> "Readings":
        recordings, out, notes = at_a_lower_rate(given, [not_counting(each) for each in given])
        factors = [round(whole.fs_hz / one.fs_hz) for whole, one in zip(given, recordings, strict=True)]
        across = [
            across_steps(whole.u, factor) if factor > 1 else np.zeros(0, int)
            for whole, factor in zip(given, factors, strict=True)
        ]
        out = [np.union1d(one, more).astype(int) for one, more in zip(out, across, strict=True)]
        if any(map(len, across)):
            notes = (*notes, "Means across a step of the voltage do not count.")
        return cls(given, recordings, out, across, notes)

    def records(self, sealed: float = SEALED) -> list[Record]:
        """Prepare the recordings, with this share of each sealed."""
        return prepare(self.recordings, self.out, as_recorded=self.given, sealed=sealed)

    def wrong(self, records: Sequence[Record], final: Fit) -> list[np.ndarray]:
        """Return the wrong readings of each recording, (readings,), judged by the residual of a fit."""
        return wrong_readings(records, self.apart, final)

    @property
    def apart(self) -> list[np.ndarray]:
        """(readings,) for each recording: those that do not count although they were read."""
        return [
            np.setdiff1d(each, np.union1d(one.not_read, across))
            for each, one, across in zip(self.out, self.recordings, self.across, strict=True)
        ]

    def masked(self, wrong: Sequence[np.ndarray]) -> tuple[str, ...]:
        """Return a sentence for each recording with readings that do not count, besides the wrong ones."""
        counts = [len(np.setdiff1d(*each)) for each in zip(self.apart, wrong, strict=True)]
        return tuple(
            f"{one.name}: readings that do not count because they stand apart from their neighbours: {count}."
            " Such readings are wrong, late, or the tail of the noise."
            for one, count in zip(self.recordings, counts, strict=True)
            if count
        )

    def without(self, wrong: Sequence[np.ndarray]) -> "Readings":
        """Return the readings less these of each recording, (readings,)."""
        out = [np.union1d(one, more).astype(int) for one, more in zip(self.out, wrong, strict=True)]
        return replace(self, out=out)

    def at_their_ticks(self, seen: Sequence[np.ndarray]) -> "Readings":
        """Return the readings without the share, (time,) for each recording, of the next step that each has
        seen, less those that have seen most of it."""
        recordings = [
            replace(one, y=at_their_ticks(one.y, share), as_read=one.readings)
            for one, share in zip(self.recordings, seen, strict=True)
        ]
        return replace(self, recordings=recordings).without([np.flatnonzero(s > MOST_SEEN) for s in seen])
