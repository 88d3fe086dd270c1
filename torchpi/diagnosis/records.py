"""The recordings prepared for the search, and which of their samples it may see."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchpi.diagnosis.coefficients import Coefficients
from torchpi.diagnosis.long_recordings import means, shifted
from torchpi.diagnosis.monitored import monitor_noise, without_noise
from torchpi.recordings.faults import dropouts
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.effect import DataRange

SEALED = 0.15
"""Share of each recording, at its end, that neither a fit nor the choice between hypotheses sees."""
AT_MOST = 30_000
"""Maximum number of coefficients that a search sums over, in all recordings together."""
LEVELS = 8.0
"""Number of scales among which these coefficients are divided."""


@dataclass(frozen=True, eq=False)
class Rests:
    """Where a mount sticks, according to the readings."""

    stuck: np.ndarray
    """(time,), bool: the reading did not jump."""
    at_um: np.ndarray
    """(time,): the mean of the readings since the last jump, without the present one."""


@dataclass(frozen=True, eq=False)
class Record:
    """One recording, and which part of it is fitted."""

    name: str
    u: np.ndarray
    """The voltage as it was recorded."""
    y: np.ndarray
    fs_hz: float
    aux: dict[str, np.ndarray]
    train: np.ndarray
    """(time,), bool: fitted samples, without sealed end, skipped start-up and samples that do not count."""
    held_out: np.ndarray
    """(time,), bool: samples not trained on, except those that do not count: dropouts, an unsettled start."""
    coefficients: Coefficients
    """The coefficients that a fit sums over."""
    tick_s: float
    """Period of the controller; shorter than a sample period where samples are means."""
    commands: Mapping[int, np.ndarray]
    """(time,), V each, by number of ticks: the voltage of so many ticks before tick k; if monitored, without
    the noise of the monitor."""
    simulated: Mapping[int, np.ndarray]
    """(time,), µm each, under the same keys: a simulator's output; empty if the recording has none."""
    monitor_noise_v: float
    """Standard deviation of the noise that the monitor of the voltage adds, V; 0 for a command."""
    monitor_noise_left_v: np.ndarray
    """(time,): standard deviation of what is left of it in the voltage that drives."""
    late_s: np.ndarray | None = None
    """(time,): how late each reading was taken; None if the clock does not jitter."""
    rests: Rests | None = None
    """None where no sticking mount was seen."""

    def commanded(self, alignment: int) -> np.ndarray:
        """Return the command to which y(k) responds: that of tick k, or of `alignment` ticks before."""
        return self.commands[alignment]

    @property
    def period_s(self) -> float:
        return 1.0 / self.fs_hz


def not_counting(recording: Recording) -> np.ndarray:
    """Return the indices of samples that say nothing about the stage: wrong or missing readings."""
    wrong = dropouts(recording.y, recording.u, recording.output_step_um)
    return np.union1d(wrong, recording.not_read).astype(int)


def prepare(
    recordings: Sequence[Recording],
    dropouts: Sequence[np.ndarray],
    skip_s: float = 0.0,
    as_recorded: Sequence[Recording] | None = None,
    sealed: float = SEALED,
) -> list[Record]:
    """Prepare the recordings, with their ends sealed.

    Args:
        recordings: One or more.
        dropouts: For each the indices of readings that do not count.
        skip_s: Start-up of each recording, at most half of it, that is held out like its end, s.
        as_recorded: The same recordings at the rate of the controller, where some are means.
        sealed: Share of each recording that is sealed; 0 for the fit of the model that is delivered.
    """
    noise_v = monitor_noise([recording.u for recording in recordings])
    given = as_recorded or recordings
    return [
        _record(one, int((1 - sealed) * len(one.u)), wrong, len(recordings), skip_s, at_ticks, sd)
        for one, wrong, at_ticks, sd in zip(recordings, dropouts, given, noise_v, strict=True)
    ]


def without_start(records: Sequence[Record], readings: Sequence[int]) -> list[Record]:
    """Return the records with their first `readings` samples excluded: neither fitted nor held out."""
    found = []
    for record, first in zip(records, readings, strict=True):
        counts = np.arange(len(record.u)) >= first
        train = record.train & counts
        found.append(
            replace(
                record,
                train=train,
                held_out=record.held_out & counts,
                coefficients=_coefficients(
                    record.u, record.y, record.coefficients.samples, train, len(records)
                ),
            )
            if first
            else record
        )
    return found


def _record(
    recording: Recording,
    samples: int,
    wrong: np.ndarray,
    recordings: int,
    skip_s: float,
    given: Recording,
    monitor_noise_v: float,
) -> Record:
    u, y = recording.u.astype(np.float64), recording.y.astype(np.float64)
    valid, fitted = np.ones(len(u), dtype=bool), np.arange(len(u)) < samples
    valid[wrong] = False
    fitted[: min(round(skip_s * recording.fs_hz), len(u) // 2)] = False
    ticks, simulated = round(given.fs_hz / recording.fs_hz), {}
    driving = {
        late: without_noise(one, monitor_noise_v) for late, one in _early_and_late(u, given.u, ticks).items()
    }
    if recording.simulated is not None and given.simulated is not None:
        simulated = _early_and_late(recording.simulated, given.simulated, ticks)
    return Record(
        recording.name,
        u,
        y,
        recording.fs_hz,
        recording.aux,
        fitted & valid,
        ~fitted & valid,
        _coefficients(u, y, samples, fitted & valid, recordings),
        tick_s=1.0 / given.fs_hz,
        commands={late: one for late, (one, _) in driving.items()},
        simulated=simulated,
        monitor_noise_v=monitor_noise_v,
        monitor_noise_left_v=driving[0][1],
        late_s=recording.late_s,
    )


def _early_and_late(x: np.ndarray, at_ticks: np.ndarray, ticks: int) -> dict[int, np.ndarray]:
    """Return a signal (time,), and the same one controller tick earlier and later, under keys 0, -1 and 1.

    Args:
        x: The signal.
        at_ticks: (ticks,), the values of which its samples are means.
        ticks: Number of ticks in each mean.
    """
    return {0: x, **{late: means(shifted(at_ticks, late), ticks)[: len(x)] for late in (-1, 1)}}


def _coefficients(
    u: np.ndarray, y: np.ndarray, samples: int, valid: np.ndarray, recordings: int
) -> Coefficients:
    # Second differences are large where something fast happens: at edges, and in the ringing after them.
    activity = np.diff(y, 2, prepend=y[:1], append=y[-1:])
    at_most = max(200, int(AT_MOST / recordings / LEVELS) * 2)
    return Coefficients.of(u, activity, samples, valid, at_most)


def seen(records: Sequence[Record]) -> DataRange:
    """Return the ranges that these recordings span."""
    rates = np.concatenate([np.abs(np.diff(record.u)) * record.fs_hz for record in records])
    names = {name for record in records for name in record.aux}
    return DataRange(
        fs_hz=max(record.fs_hz for record in records),
        duration_s=max(record.coefficients.samples / record.fs_hz for record in records),
        low_v=min(float(record.u.min()) for record in records),
        high_v=max(float(record.u.max()) for record in records),
        # Steps between long holds are too rare to show in a percentile.
        max_rate_v_s=float(np.quantile(rates, 0.999) or rates.max()),
        low_um=min(float(record.y.min()) for record in records),
        high_um=max(float(record.y.max()) for record in records),
        aux={n: max(float(r.aux[n].std()) for r in records if n in r.aux) for n in sorted(names)},
        peak_rate_v_s=float(rates.max()),
        quickest_s=min(_time_to_move_s(record.commanded(0), record.fs_hz) for record in records),
    )


def _time_to_move_s(u: np.ndarray, fs_hz: float) -> float:
    """Return σ_u/σ_u̇, s, which is 1/ω for a sine."""
    rate = float(np.diff(u).std()) * fs_hz
    return float(u.std()) / rate if rate else np.inf
