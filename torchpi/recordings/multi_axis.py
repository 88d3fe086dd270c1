"""Recordings of several axes: `time_s,input_1_v,input_2_v,…[,output_1_um,…]`, or a benchmark's arrays."""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from torchpi.errors import RecordingError, RecordingWarning
from torchpi.files import write_columns
from torchpi.recordings.options import TIME_COLUMN, RecordingOptions
from torchpi.recordings.readers import open_source
from torchpi.recordings.readers.npz import NpzSource
from torchpi.recordings.readers.source import Source
from torchpi.recordings.signal import read_signal

INPUT, OUTPUT = re.compile(r"input_(\d+)(_v|\b)"), re.compile(r"output_(\d+)(_um|\b)")
DESIRED = re.compile(r"yd_(\d+)(_um|\b)")
MOST_PERIODS, REPEATED = 32, 0.01
"""Most periods of a repeated excitation; share of its rms by which periods of a monitored one may differ."""
PARALLEL = 1e-6
"""Ratio of the least to the largest eigenvalue of the inputs' correlation below which they move together."""


@dataclass(frozen=True, eq=False)
class MultiAxisRecording:
    """Voltages and displacements of one run, uniformly sampled.

    Attributes:
        name: Name of the file and of the run in it.
        u: (time, inputs), V.
        y: (time, outputs), µm; has no columns if none were recorded.
        fs_hz: Sample rate, Hz.
        periods: Number of periods of a periodic excitation, in steady state; 1 for any other recording.
    """

    name: str
    u: np.ndarray
    y: np.ndarray
    fs_hz: float
    periods: int = 1

    @cached_property
    def period(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the mean period of voltages and displacements (displacements about their mean), and the rms
        of the noise in that mean, estimated from the differences between periods, µm."""
        length = len(self.u) // self.periods
        u = self.u[: length * self.periods].reshape(self.periods, length, -1)
        y = self.y[: length * self.periods].reshape(self.periods, length, -1)
        mean = y.mean(0)
        each = (y - y.mean(1, keepdims=True)) - (mean - mean.mean(0))
        noise = float(np.sqrt((each**2).mean() / max(self.periods - 1, 1)))
        return u.mean(0), mean - mean.mean(0), noise


def read_multi_axis(
    path: str | Path, options: RecordingOptions | None = None, periods: int | None = 1
) -> MultiAxisRecording:
    """Read a file whose columns are named `input_1_v`, `input_2_v`, … and `output_1_um`, ….

    Args:
        path: CSV, or any other kind of file with named columns.
        options: Time column and sample rate.
        periods: Number of periods of a periodic excitation in the file; None detects it.

    Raises:
        RecordingError: No such columns, a gap in their numbers, or a file that cannot be read.
    """
    options = options or RecordingOptions()
    source = open_source(path)
    inputs, outputs = columns(source, INPUT, "input_1_v"), columns(source, OUTPUT, "")
    signals = [read_signal(path, name, options=options, unit="V") for name in inputs]
    signals += [read_signal(path, name, options=options, unit="um") for name in outputs]
    length, fs_hz = len(signals[0].x), signals[0].fs_hz
    values = np.stack([signal.x for signal in signals], 1)
    split = len(inputs)
    if periods is None:
        periods = whole_periods(values[:, :split])
    if periods < 1 or length % periods:
        raise RecordingError(f"{path}: found {length} samples, expected a multiple of {periods} periods")
    return MultiAxisRecording(Path(path).stem, values[:, :split], values[:, split:], fs_hz, periods)


def has_axes(source: Source) -> bool:
    """Whether a file has numbered inputs, and so is a recording of several axes."""
    return any(INPUT.match(name) for name in source.names)


def whole_periods(u: np.ndarray) -> int:
    """Return how many whole periods the inputs (time, inputs) contain from the first sample to the last."""
    size = float(u.std())
    for periods in range(MOST_PERIODS, 1, -1):
        length, left = divmod(len(u), periods)
        if not left and length > 1 and (u[length:] - u[:-length]).std() < REPEATED * size:
            return periods
    return 1


def columns(source: Source, kind: re.Pattern[str], first: str) -> list[str]:
    """Return the names of the numbered columns of a kind, in order.

    Args:
        source: An open file.
        kind: `INPUT` or `OUTPUT`.
        first: Name of the first column, for the error message; empty if none is required.

    Raises:
        RecordingError: If a number is missing.
    """
    found = {int(match[1]): name for name in source.names if (match := kind.match(name))}
    if not found and first:
        raise RecordingError(f"{source.path}: no column '{first}', expected numbered inputs and outputs")
    if sorted(found) != list(range(1, len(found) + 1)):
        raise RecordingError(
            f"{source.path}: found columns {', '.join(found.values())}, expected numbers from 1 without a gap"
        )
    return [found[number] for number in sorted(found)]


def read_realisations(path: str | Path, fs_hz: float, um_per_unit: float = 1.0) -> list[MultiAxisRecording]:
    """Read an archive of pairs of arrays `u_NAME`, `y_NAME`, each (samples, channels, realisations, periods).

    Args:
        path: A NumPy archive.
        fs_hz: Sample rate, Hz.
        um_per_unit: How many µm 1 in `y_NAME` stands for.

    Raises:
        RecordingError: No such pairs, or arrays of other shapes.
    """
    source = NpzSource(str(path))
    names = [name[2:] for name in source.names if name.startswith("u_") and f"y_{name[2:]}" in source.names]
    if not names:
        raise RecordingError(f"{path}: found {', '.join(source.names)}, expected arrays u_NAME and y_NAME")
    found = []
    for name in names:
        u, y = np.asarray(source.array(f"u_{name}"), float), np.asarray(source.array(f"y_{name}"), float)
        if u.ndim != 4 or y.ndim != 4 or u.shape[::2] != y.shape[::2] or u.shape[3] != y.shape[3]:
            raise RecordingError(
                f"{path}: {name}: found arrays of shapes {u.shape} and {y.shape}, "
                "expected (samples, channels, realisations, periods)"
            )
        for run in range(u.shape[2]):
            one, other = (a[:, :, run].transpose(2, 0, 1).reshape(-1, a.shape[1]) for a in (u, y))
            found.append(MultiAxisRecording(f"{name} {run + 1}", one, um_per_unit * other, fs_hz, u.shape[3]))
    return found


def usable(recordings: Sequence[MultiAxisRecording]) -> list[MultiAxisRecording]:
    """Return the recordings of one stage, checked that they show the effect of each input.

    An input that never moves is left out with a `RecordingWarning`.

    Raises:
        RecordingError: If numbers of inputs, numbers of outputs or sample rates differ, a value is not
            finite, no input moves, or inputs always move in proportion.
    """
    first = recordings[0]
    for one in recordings:
        found = (one.u.shape[1], one.y.shape[1], one.fs_hz)
        expected = (first.u.shape[1], first.y.shape[1], first.fs_hz)
        if found != expected:
            raise RecordingError(
                f"{one.name}: found {found[0]} inputs and {found[1]} outputs at {found[2]:g} Hz, expected "
                f"{expected[0]}, {expected[1]} and {expected[2]:g} Hz as in {first.name}"
            )
        if not (np.isfinite(one.u).all() and np.isfinite(one.y).all()):
            raise RecordingError(f"{one.name}: found a value that is not finite, expected numbers")
    if first.y.shape[1] == 0:
        raise RecordingError(
            f"{first.name}: no column 'output_1_um', expected the displacements beside the inputs"
        )
    u = np.concatenate([one.u - one.u.mean(0) for one in recordings])
    moving = np.flatnonzero(np.ptp(u, axis=0) > 0)
    names = [f"input_{i + 1}_v" for i in moving]
    if not names:
        raise RecordingError(f"{first.name}: found inputs that never move, expected at least one that does")
    if still := [f"input_{i + 1}_v" for i in range(u.shape[1]) if i not in moving]:
        warnings.warn(
            f"{', '.join(still)}: found the same value throughout, so left out; the inputs of the stage are "
            f"{', '.join(names)}",
            RecordingWarning,
            stacklevel=2,
        )
    values, axes = np.linalg.eigh(np.corrcoef(u[:, moving].T).reshape(len(moving), -1))
    if values[0] < PARALLEL * values[-1]:
        alike = ", ".join(names[i] for i in np.flatnonzero(np.abs(axes[:, 0]) > 1e-3))
        raise RecordingError(
            f"{alike}: found inputs that always move in proportion, so that their effects cannot be "
            "separated; expected each to move independently"
        )
    return list(recordings) if not still else [replace(one, u=one.u[:, moving]) for one in recordings]


def write_multi_axis(path: str | Path, recording: MultiAxisRecording) -> None:
    """Write `time_s,input_1_v,…,output_1_um,…` as CSV, whole or not at all, every double exact."""
    names = [f"input_{i + 1}_v" for i in range(recording.u.shape[1])]
    names += [f"output_{i + 1}_um" for i in range(recording.y.shape[1])]
    t = np.arange(len(recording.u))[:, None] / recording.fs_hz
    table = np.concatenate([t, recording.u, recording.y], axis=1)
    write_columns(path, [TIME_COLUMN, *names], table.T.tolist())
