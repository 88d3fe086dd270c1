"""Contents of a file of signals and what its recording shows without a model, for `torchpi check`."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchpi.errors import RecordingError, RecordingWarning
from torchpi.recordings.faults import dropouts, in_phase_correlation, noise_estimate
from torchpi.recordings.options import RecordingOptions
from torchpi.recordings.readers import Source, open_source
from torchpi.recordings.readers.header import Role
from torchpi.recordings.readers.time_stamps import uniform_grid
from torchpi.recordings.recording import Recording, read_recording
from torchpi.recordings.time_base import column_of, time_stamps

MOST_COLUMNS = 40  # of a file of many arrays, only the first are listed
PREVIEWED = 5
HOLD_SAMPLES = 16  # least length of a hold
HOLD_SPREAD = 7.0  # standard deviations; 16 samples of noise exceed this range once in ten thousand


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a file."""

    name: str
    unit: str | None
    """Unit as the file states it."""
    values: np.ndarray | None
    """(time,), in the file's own unit; None if there are no numbers to show."""
    problem: str = ""
    """Why there are no numbers."""


@dataclass(frozen=True)
class Holds:
    """Stretches in which the input stands still, within its own noise."""

    count: int
    longest_s: float
    share: float
    """Share of all samples that lie in holds, 0…1."""


@dataclass(frozen=True, eq=False)
class Summary:
    """What can be seen of one recording without a model."""

    recording: Recording
    options: RecordingOptions
    """The given options, with those added that this file needs."""
    columns: dict[Role, str]
    """Column of the file by role; without time if the stamps are not used."""
    guessed: bool
    """Whether the columns were identified by their content, not by name."""
    jitter: float | None
    """Largest deviation of a time stamp from the uniform grid, in sample periods; None without stamps."""
    holds: Holds
    input_noise_v: float
    output_noise_um: float
    """Noise from sample to sample; an upper bound if the motion is fast."""
    output_step_um: float
    gain_um_per_v: float
    correlation: float
    """Correlation of input and output at the same instant; its sign is the gain's."""
    comes_back_um: float | None
    """How much higher the output stands once the input returns to its first value; None if it never does."""
    dropouts: np.ndarray
    """Indices of single wrong readings."""
    warnings: list[str]
    """Warnings of `check_recording`, without the file's name."""

    @property
    def input_is_noisy(self) -> bool:
        """Whether the input changes by more than rounding: a monitored voltage, or a fast one."""
        return self.input_noise_v > 1e-6 * float(np.ptp(self.recording.u))


def columns_in(source: Source) -> list[Column]:
    """Return the columns of a file, with their values if they are numeric."""
    names = [name for name in source.names if name][:MOST_COLUMNS]
    try:
        values = source.read([name for name in names if source.holds_numbers(name)])
        read = dict(zip([name for name in names if source.holds_numbers(name)], values, strict=True))
        return [
            Column(name, source.unit(name), read.get(name), "" if name in read else "text") for name in names
        ]
    except RecordingError:
        return [_column(source, name) for name in names]


def summarise(path: str | Path, options: RecordingOptions | None = None) -> Summary:
    """Read a recording as the commands do, and measure what can be seen without a model.

    Args:
        path: a file of any kind that `read_recording` reads.
        options: as for every command. Options that this file needs are added: columns that can be identified
            by their content, and `resample` if the sampling is not uniform.

    Raises:
        RecordingError: states what is wrong with the file.
    """
    source = open_source(path)
    options, guessed = _with_guesses(source, options or RecordingOptions())
    stamps = time_stamps(source, options)
    jitter = None
    if stamps is not None and len(stamps[1]) > 2 and np.isfinite(stamps[1]).all():
        t = stamps[1]
        steps = np.diff(t)
        if np.all(steps > 1e-12) and t[-1] - t[0] < 1e12:
            grid = uniform_grid(t)
            jitter = float(np.abs(t - t[0] - np.arange(len(t)) / grid.fs_hz).max() * grid.fs_hz)
            if grid.odd_sample is not None:
                jitter = float(np.abs(steps / grid.median_step_s - 1).max())
                options = options.with_changes(resample=True)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RecordingWarning)
        recording = read_recording(path, options, allow_constant_input=True)
    columns: dict[Role, str] = {"time": stamps[0]} if stamps else {}
    columns["input"] = column_of(source, options.input_column, "input")
    columns["output"] = column_of(source, options.output_column, "output")
    said = [str(warning.message).removeprefix(f"{path}: ") for warning in caught]
    return summary_of(recording, options, columns, guessed, jitter, said)


def summary_of(
    recording: Recording,
    options: RecordingOptions | None = None,
    columns: dict[Role, str] | None = None,
    guessed: bool = False,
    jitter: float | None = None,
    warnings: Sequence[str] = (),
) -> Summary:
    """Measure what can be seen of a recording without a model; facts about its file are passed in."""
    u, y = recording.u, recording.y
    input_noise = noise_estimate(u)
    power = float((u - u.mean()) @ (u - u.mean()))
    return Summary(
        recording=recording,
        options=options or RecordingOptions(),
        columns=columns or {},
        guessed=guessed,
        jitter=jitter,
        holds=holds_of(u, recording.fs_hz, input_noise),
        input_noise_v=input_noise,
        output_noise_um=noise_estimate(y),
        output_step_um=recording.output_step_um,
        gain_um_per_v=float((u - u.mean()) @ (y - y.mean())) / power if power else 0.0,
        correlation=in_phase_correlation(u, y),
        comes_back_um=comes_back(u, y),
        dropouts=dropouts(y, u, recording.output_step_um),
        warnings=list(warnings),
    )


def holds_of(u: np.ndarray, fs_hz: float, noise: float) -> Holds:
    """Find where the input stands still, within 7 standard deviations of its noise, for 16 samples or more.

    Args:
        u: (time,), V.
        fs_hz: sample rate.
        noise: standard deviation of the noise of a monitored voltage; 0 for a command.
    """
    blocks = len(u) // HOLD_SAMPLES
    if not blocks:
        return Holds(0, 0.0, 0.0)
    table = u[: blocks * HOLD_SAMPLES].reshape(blocks, HOLD_SAMPLES)
    still = np.ptp(table, axis=1) <= HOLD_SPREAD * noise
    # Adjacent still blocks form one hold if their means agree; the mean of 16 samples has an error of σ/4.
    same = np.abs(np.diff(table.mean(axis=1))) <= HOLD_SPREAD * noise / 2
    begins = still & ~np.concatenate(([False], still[:-1] & same))
    if not still.any():
        return Holds(0, 0.0, 0.0)
    lengths = np.bincount(np.cumsum(begins)[still] - 1) * HOLD_SAMPLES
    return Holds(int(begins.sum()), float(lengths.max() / fs_hz), float(still.mean()))


def comes_back(u: np.ndarray, y: np.ndarray) -> float | None:
    """Return how much higher y stands on average once u has left its first value and returned to it.

    A stage that starts de-energised returns to its first voltage with its remanence added; one that starts
    on its loop returns to where it was.

    Returns:
        µm; None if u never leaves its first value by a fifth of its range, or never returns to it.
    """
    away = np.flatnonzero(np.abs(u - u[0]) > 0.2 * np.ptp(u))
    if np.ptp(u) == 0 or not len(away):
        return None
    back = np.abs(u[away[0] :] - u[0]) <= 0.01 * np.ptp(u)
    return float(y[away[0] :][back].mean() - y[0]) if back.any() else None


def _column(source: Source, name: str) -> Column:
    try:
        (values,) = source.read([name])
    except RecordingError as error:
        return Column(name, None, None, str(error).removeprefix(f"{source.path}: "))
    return Column(name, source.unit(name), values)


def _with_guesses(source: Source, options: RecordingOptions) -> tuple[RecordingOptions, bool]:
    """Return the options, with columns identified by their content if their names are unknown.

    The time is a column that rises steadily; of two other columns that move, the first is the input.
    """
    try:
        column_of(source, options.input_column, "input")
        column_of(source, options.output_column, "output")
        return options, False
    except RecordingError as error:
        defaults = RecordingOptions()
        if (options.input_column, options.output_column) != (defaults.input_column, defaults.output_column):
            raise
        columns = [column for column in columns_in(source) if column.values is not None]
        moving = {c.name: c.values for c in columns if c.values is not None and _moves(c.values)}
        rising = [name for name, x in moving.items() if np.all(np.diff(x) > 0)]
        signals = [name for name in moving if name not in rising]
        if len(signals) != 2 or len(rising) > 1:
            raise error from None
        changes = {"input_column": signals[0], "output_column": signals[1]}
        if rising and options.time_column == defaults.time_column:
            changes["time_column"] = rising[0]
        return options.with_changes(**changes), True


def _moves(x: np.ndarray) -> bool:
    return len(x) > 1 and bool(np.isfinite(x).all()) and float(x.max()) > float(x.min())
