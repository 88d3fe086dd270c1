"""What the search works on: the recordings, cut into what is fitted and what is held out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchpi.recordings.recording import Recording
from torchpi.stage.effects.effect import Seen

HELD_OUT = (0.25, 0.55, 0.85)
"""Where the held-out tenths of a recording begin."""
RARE, EDGE, SHOWS = 0.999, 1.5, 8
"""An edge moves the command so many times farther than this share of samples does; samples it shows."""


@dataclass(frozen=True, eq=False)
class Rests:
    """Where a mount sticks, as the readings show it."""

    stuck: np.ndarray
    """(time,), bool: the reading did not jump."""
    at_um: np.ndarray
    """(time,): the mean of the readings since the last jump, this one apart."""


@dataclass(frozen=True, eq=False)
class Record:
    """One recording, and which of its samples are fitted."""

    name: str
    u: np.ndarray
    y: np.ndarray
    fs_hz: float
    aux: dict[str, np.ndarray]
    train: np.ndarray
    """(time,), bool; the rest is held out."""
    fitted: np.ndarray
    """Indices of the training samples that a fit sums over: few enough for a search to be quick."""
    held_out: tuple[slice, ...] = ()
    """The blocks that are held out."""
    rests: Rests | None = None
    """None where no mount that sticks was seen."""

    def commanded(self, alignment: int) -> np.ndarray:
        """The command that y(k) answers: that of tick k, or of `alignment` ticks before."""
        if alignment == 0:
            return self.u
        return np.concatenate([np.zeros(alignment), self.u[:-alignment]])

    @property
    def period_s(self) -> float:
        return 1.0 / self.fs_hz


def prepare(recordings: Sequence[Recording], at_most: int = 25_000) -> list[Record]:
    """Three contiguous tenths of each recording are held out: the state carries over to them.

    Fits sum over every so many training samples, about `at_most` in all, and over those after an edge.
    """
    stride = max(1, round(0.7 * sum(len(recording.u) for recording in recordings) / at_most))
    records = []
    for recording in recordings:
        train = np.ones(len(recording.u), dtype=bool)
        blocks = tuple(slice(int(start * len(train)), int((start + 0.1) * len(train))) for start in HELD_OUT)
        for block in blocks:
            train[block] = False
        records.append(_record(recording, train, stride, blocks))
    return records


def whole(recordings: Sequence[Recording], at_most: int = 40_000) -> list[Record]:
    """The same with nothing held out: what the model that is left behind is fitted to."""
    stride = max(1, round(sum(len(recording.u) for recording in recordings) / at_most))
    return [_record(r, np.ones(len(r.u), dtype=bool), stride) for r in recordings]


def _record(recording: Recording, train: np.ndarray, stride: int, held_out: tuple[slice, ...] = ()) -> Record:
    u = recording.u.astype(np.float64)
    fitted = np.zeros(len(u), dtype=bool)
    fitted[np.flatnonzero(train)[::stride]] = True
    fitted |= after_edges(u) & train
    return Record(
        recording.name, u, recording.y.astype(np.float64), recording.fs_hz, recording.aux, train,
        np.flatnonzero(fitted), held_out,
    )  # fmt: skip


def after_edges(u: np.ndarray) -> np.ndarray:
    """(time,), bool: the few samples in which a limit of the rate, or a quick lag, shows at all."""
    moves = np.abs(np.diff(u, prepend=u[0]))
    after = np.zeros(len(u), dtype=bool)
    for edge in np.flatnonzero(moves > EDGE * np.quantile(moves, RARE)):
        after[edge : edge + SHOWS] = True
    return after


def seen(records: Sequence[Record]) -> Seen:
    """What these recordings span."""
    rates = np.concatenate([np.abs(np.diff(record.u)) * record.fs_hz for record in records])
    names = {name for record in records for name in record.aux}
    return Seen(
        fs_hz=max(record.fs_hz for record in records),
        duration_s=max(len(record.u) / record.fs_hz for record in records),
        low_v=min(float(record.u.min()) for record in records),
        high_v=max(float(record.u.max()) for record in records),
        # Steps between long holds are too few for a percentile to see.
        max_rate_v_s=float(np.quantile(rates, 0.999) or rates.max()),
        low_um=min(float(record.y.min()) for record in records),
        high_um=max(float(record.y.max()) for record in records),
        aux={n: max(float(r.aux[n].std()) for r in records if n in r.aux) for n in sorted(names)},
        peak_rate_v_s=float(rates.max()),
    )
