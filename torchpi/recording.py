"""Recorded voltage and displacement: read from a file, checked, cut, resampled, written.

Inside, the voltage is in V, the displacement in µm, the time in s, and the sampling is uniform.
"""

import hashlib
import warnings
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np

from torchpi.errors import RecordingError, RecordingWarning
from torchpi.files import write_atomically
from torchpi.readers import Source, open_source
from torchpi.readers.source import Column
from torchpi.readers.time_stamps import Grid, round_rate, uniform_grid
from torchpi.recording_checks import MIN_SAMPLES, check_length, check_recording
from torchpi.resampling import to_rate

__all__ = ["Recording", "Signal", "check_recording", "read_recording", "read_signal", "write_recording"]

TIME_COLUMN, INPUT_COLUMN, OUTPUT_COLUMN = "time_s", "input_v", "output_um"
RATE_TOLERANCE = 5e-3  # what coarse time stamps may leave open of the sample rate
RATE_AGREEMENT = 1e-4  # between the stamps and a rate that the user gives


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """Voltage and displacement of one run of a stage, uniformly sampled, as `read_recording` leaves them."""

    name: str
    """The file's name without its suffix."""
    t: np.ndarray
    """(time,), s."""
    u: np.ndarray
    """(time,), V, the controller's voltage, held between samples."""
    y: np.ndarray
    """(time,), µm."""
    fs_hz: float
    aux: dict[str, np.ndarray] = field(default_factory=dict)
    """Other recorded signals (time,), under their column names, `aux_…`."""
    source: str = ""
    """The path as it was given."""
    sha256: str = ""
    """Of the file's bytes."""

    def __post_init__(self) -> None:
        lengths = {"t": len(self.t), "u": len(self.u), "y": len(self.y)}
        lengths |= {name: len(signal) for name, signal in self.aux.items()}
        if len(set(lengths.values())) > 1:
            found = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise RecordingError(
                f"{self.source or self.name}: unequal lengths: {found} samples; cut them to one"
            )

    def __repr__(self) -> str:
        if not len(self):
            return f"Recording({self.name!r}, empty)"
        return (
            f"Recording({self.name!r}, {len(self):,} samples at {self.fs_hz:g} Hz, {self.duration_s:g} s, "
            f"u {self.u.min():.4g}…{self.u.max():.4g} V, y {self.y.min():.4g}…{self.y.max():.4g} µm)"
        )

    def __len__(self) -> int:
        return len(self.u)

    @property
    def duration_s(self) -> float:
        return len(self.u) / self.fs_hz

    def slice(self, start_s: float, stop_s: float) -> "Recording":
        """The samples with start_s ≤ t < stop_s, by the file's own time stamps, which they keep."""
        edge = 1e-3 / self.fs_hz  # a stamp that should equal the edge may lie just beside it
        first, last = np.searchsorted(self.t, [start_s - edge, stop_s - edge])
        if first >= last:
            raise RecordingError(
                f"{self.source or self.name}: no samples from {start_s:g} s to {stop_s:g} s, "
                f"the recording runs from {self.t[0]:g} s to {self.t[-1]:g} s; choose times inside it"
            )
        return self._cut(int(first), int(last))

    def split_tail(self, fraction: float) -> tuple["Recording", "Recording"]:
        """(the head, the last `fraction` of the samples). Random samples would leak: neighbours are alike."""
        tail = round(len(self) * fraction)
        if not 0 < tail < len(self):
            raise RecordingError(
                f"{self.source or self.name}: a tail of {fraction:g} of {len(self)} samples leaves "
                "nothing to one "
                f"part, wanted a fraction between 0 and 1; choose another"
            )
        return self._cut(0, len(self) - tail), self._cut(len(self) - tail, len(self))

    def with_zero(self, zero: Literal["none", "first"]) -> "Recording":
        """The displacement from its first sample on (`first`): a sensor's own zero is often arbitrary."""
        if zero not in ("none", "first"):
            raise RecordingError(f"{self.source or self.name}: zero is '{zero}', wanted none or first")
        return replace(self, y=self.y - self.y[0]) if zero == "first" else self

    def resampled(self, fs_hz: float) -> "Recording":
        """The same signals at another rate, without aliasing, and all with the same (no) delay.

        Signals are taken as band-limited below half of the lower rate. That includes the voltage, which a
        converter holds: the half sample of delay that holding adds belongs to the rate it was recorded at.
        """
        if not (np.isfinite(fs_hz) and fs_hz > 0):
            raise RecordingError(
                f"{self.source or self.name}: cannot resample to {fs_hz:g} Hz, wanted a rate over 0"
            )
        if fs_hz == self.fs_hz:
            return self
        samples = int(np.floor((len(self) - 1) * fs_hz / self.fs_hz + 1e-6)) + 1
        convert = {
            name: to_rate(signal, self.fs_hz, fs_hz, samples) for name, signal in self._signals().items()
        }
        u, y = convert.pop("u"), convert.pop("y")
        return replace(
            self, t=self.t[0] + np.arange(samples) / fs_hz, u=u, y=y, fs_hz=float(fs_hz), aux=convert
        )

    def _signals(self) -> dict[str, np.ndarray]:
        return {"u": self.u, "y": self.y, **self.aux}

    def _cut(self, first: int, last: int) -> "Recording":
        aux = {name: signal[first:last] for name, signal in self.aux.items()}
        return replace(self, t=self.t[first:last], u=self.u[first:last], y=self.y[first:last], aux=aux)


@dataclass(frozen=True, eq=False)
class Signal:
    """One uniformly sampled signal of a file: a trajectory to follow, a voltage to play."""

    name: str
    t: np.ndarray
    """(time,), s."""
    x: np.ndarray
    """(time,), µm or V."""
    fs_hz: float
    source: str
    sha256: str


def read_recording(
    path: str | Path,
    *,
    time_column: Column | None = TIME_COLUMN,
    input_column: Column = INPUT_COLUMN,
    output_column: Column = OUTPUT_COLUMN,
    fs_hz: float | str | None = None,
    resample: bool = False,
    input_unit: str = "V",
    output_unit: str = "um",
    zero: Literal["none", "first"] = "none",
    min_samples: int = MIN_SAMPLES,
    allow_constant_input: bool = False,
) -> Recording:
    """Read voltage and displacement from a file and check them.

    The suffix says the kind: text (.csv .txt .dat .tsv .asc), .npz, .mat, and with the extra `torchpi[io]`
    .h5 .hdf5 .tdms .mf4 .mdf and the .mat of version 7.3. Columns named `aux_…` come along.

    Args:
        path: the file.
        time_column: name or number (from 1) of the time stamps, s; None: there are none that count.
            Where the file has no column of the default name, `fs_hz` or the format's own time base is used.
        input_column: name or number of the voltage; in array files also `name[:,0]`, in structs
        `struct.field`. output_column: name or number of the displacement. fs_hz: sample rate, Hz, or the name
        of the number in the file that holds it. With time stamps beside it,
            it must agree with them, or `resample` brings the recording to it.
        resample: interpolate samples that do not come at a uniform rate to one that does.
        input_unit: V, mV or kV.
        output_unit: um, nm, mm or m.
        zero: `first` subtracts the first sample of the displacement.
        min_samples: the fewest that the model needs.
        allow_constant_input: accept a hold.

    Raises:
        RecordingError: in one line, what is wrong, in which row and column, and what to do.

    Warns:
        RecordingWarning: see `check_recording`.
    """
    scale_u, scale_y = (
        _scale(INPUT_UNITS, input_unit, "input_unit"),
        _scale(OUTPUT_UNITS, output_unit, "output_unit"),
    )
    source = open_source(path)
    names = [source.find(input_column, "input_column"), source.find(output_column, "output_column")]
    if names[0] == names[1]:
        raise RecordingError(
            f"{path}: input and output are the same column '{names[0]}', wanted two; "
            f"choose with input_column and output_column"
        )
    aux_names = [name for name in source.names if name.startswith("aux_") and name not in names]
    t, rate, (u, y, *aux) = _read_uniform(
        source, names + aux_names, time_column, fs_hz, resample, min_samples
    )
    recording = Recording(
        name=Path(path).stem,
        t=t,
        u=_converted(u, scale_u),
        y=_converted(y, scale_y),
        fs_hz=rate,
        aux=dict(zip(aux_names, aux, strict=True)),
        source=str(path),
        sha256=_sha256(path),
    ).with_zero(zero)
    check_recording(recording, min_samples=min_samples, allow_constant_input=allow_constant_input)
    wanted_hz = _rate(source, fs_hz)
    return recording.resampled(wanted_hz) if wanted_hz and wanted_hz != rate else recording


def read_signal(
    path: str | Path,
    column: Column,
    *,
    option: str = "column",
    time_column: Column | None = TIME_COLUMN,
    fs_hz: float | str | None = None,
    resample: bool = False,
    unit: str = "um",
    min_samples: int = 2,
) -> Signal:
    """Read one signal, uniformly sampled, from a file of any kind that `read_recording` reads.

    Args:
        path: the file.
        column: name or number (from 1).
        option: what the user calls `column`, for the error messages.
        time_column, fs_hz, resample, min_samples: as in `read_recording`, but `fs_hz` never changes the rate.
        unit: V, mV, kV, um, nm, mm or m; the signal is returned in V or µm.

    Raises:
        RecordingError: in one line, what is wrong and what to do.
    """
    scale = _scale(INPUT_UNITS | OUTPUT_UNITS, unit, "unit")
    source = open_source(path)
    name = source.find(column, option)
    t, rate, (x,) = _read_uniform(source, [name], time_column, fs_hz, resample, min_samples)
    return Signal(Path(path).stem, t, _converted(x, scale), rate, str(path), _sha256(path))


def write_recording(path: str | Path, recording: Recording) -> None:
    """Write `time_s,input_v,output_um[,aux_…]` as CSV: every double survives; whole or not at all."""
    columns = [recording.t, recording.u, recording.y, *recording.aux.values()]
    header = ",".join([TIME_COLUMN, INPUT_COLUMN, OUTPUT_COLUMN, *recording.aux])
    row = ",".join(["%r"] * len(columns))  # repr: the shortest digits that give the same double back
    rows = map(row.__mod__, zip(*(np.asarray(c, dtype=np.float64).tolist() for c in columns), strict=True))
    with write_atomically(path) as temporary, open(temporary, "w", encoding="utf-8", newline="\n") as file:
        file.write(header + "\n")
        while chunk := list(islice(rows, 100_000)):
            file.write("\n".join(chunk) + "\n")


# How many of the unit make one of ours, or one of the unit makes of ours: dividing by 1000 rounds once,
# multiplying by 0.001 twice.
INPUT_UNITS = {"V": (1, 1), "mV": (1, 1000), "kV": (1000, 1)}
OUTPUT_UNITS = {"um": (1, 1), "nm": (1, 1000), "mm": (1000, 1), "m": (1_000_000, 1)}


def _scale(units: dict[str, tuple[int, int]], unit: str, option: str) -> tuple[int, int]:
    unit = unit.replace("µ", "u").replace("μ", "u")
    if unit not in units:
        raise RecordingError(f"{option} is '{unit}', wanted one of {', '.join(units)}")
    return units[unit]


def _converted(x: np.ndarray, scale: tuple[int, int]) -> np.ndarray:
    times, by = scale
    return x if times == by else x * times / by


def _sha256(path: str | Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _rate(source: Source, fs_hz: float | str | None) -> float | None:
    if fs_hz is None:
        return None
    try:
        rate = float(fs_hz)
    except ValueError:
        stored = source.scalar(str(fs_hz))
        if stored is None:
            raise RecordingError(
                f"{source.path}: fs_hz is '{fs_hz}', wanted a number of Hz or the name of one in the file"
            ) from None
        rate = stored
    if not (np.isfinite(rate) and rate > 0):
        raise RecordingError(f"{source.path}: fs_hz is {rate:g}, wanted a sample rate over 0 Hz")
    return rate


def _read_uniform(
    source: Source,
    names: list[str],
    time_column: Column | None,
    fs_hz: float | str | None,
    resample: bool,
    min_samples: int,
) -> tuple[np.ndarray, float, list[np.ndarray]]:
    """Time (time,), sample rate, and the signals of these names: finite, of one length, uniformly sampled."""
    rate = _rate(source, fs_hz)
    time_name = _time_name(source, time_column, rate)
    signals = source.read(names + ([time_name] if time_name else []))
    _check_lengths(source, [*names, time_name or ""], signals)
    _check_finite(source, [*names, time_name or ""], signals)
    check_length(source.path, len(signals[0]), max(2, min_samples))
    t = signals.pop() if time_name else None
    if t is None and time_column is not None and rate is None:
        t = _own_times(source, names)
    if t is None:
        if rate is None:
            raise RecordingError(
                f"{source.path}: no time stamps and no sample rate; "
                "give the rate (fs_hz) or a time column (time_column)"
            )
        return np.arange(len(signals[0])) / rate, rate, signals
    grid = uniform_grid(t)
    if grid.odd_sample is not None:
        if not resample:
            raise _not_uniform(source, grid, t)
        return _interpolated(source, grid, t, signals)
    if grid.rate_uncertainty > RATE_TOLERANCE and rate is None:
        raise RecordingError(
            f"{source.path}: the time stamps leave the sample rate open by "
            f"{100 * grid.rate_uncertainty:.2g} %, "
            f"wanted {100 * RATE_TOLERANCE:g} %; print more digits or give the rate (fs_hz)"
        )
    if rate is None or abs(grid.fs_hz / rate - 1) <= RATE_AGREEMENT + grid.rate_uncertainty:
        return t, rate or grid.fs_hz, signals
    if not resample:
        raise RecordingError(
            f"{source.path}: the time stamps make {grid.fs_hz:.9g} Hz, but fs_hz is {rate:.9g} Hz; "
            "leave out fs_hz, "
            f"bring the recording to it with `--resample true` (data.resample: true), "
            f"or leave out the stamps with time_column null"
        )
    return t, grid.fs_hz, signals


def _time_name(source: Source, time_column: Column | None, rate: float | None) -> str | None:
    if time_column is None:
        return None
    default_is_missing = time_column == TIME_COLUMN and TIME_COLUMN not in source.names
    if default_is_missing and (rate is not None or source.has_times):
        return None
    try:
        return source.find(time_column, "time_column")
    except RecordingError as error:
        raise RecordingError(f"{error}, or give the sample rate with fs_hz") from None


def _own_times(source: Source, names: list[str]) -> np.ndarray | None:
    """The format's time base of the first signal, which the others must share."""
    first = source.times(names[0])
    for name in names[1:]:
        other = source.times(name)
        if (first is None) != (other is None) or (
            first is not None and other is not None and not np.allclose(first, other, rtol=0, atol=1e-9)
        ):
            raise RecordingError(
                f"{source.path}: '{names[0]}' and '{name}' have different time bases, wanted one; "
                f"export both at one common rate, or give the rate (fs_hz)"
            )
    return first


def _check_lengths(source: Source, names: list[str], signals: list[np.ndarray]) -> None:
    if len({len(signal) for signal in signals}) > 1:
        found = ", ".join(f"'{name}' {len(signal)}" for name, signal in zip(names, signals, strict=False))
        raise RecordingError(
            f"{source.path}: unequal lengths: {found} samples, wanted one length; export them together"
        )


def _check_finite(source: Source, names: list[str], signals: list[np.ndarray]) -> None:
    bad = [~np.isfinite(signal) for signal in signals]
    rows = np.any(bad, axis=0)
    if rows.any():
        first = int(np.argmax(rows))
        column = next(k for k, mask in enumerate(bad) if mask[first])
        more = f" ({int(rows.sum())} such rows)" if rows.sum() > 1 else ""
        raise RecordingError(
            f"{source.path}: {source.place(first)}: column '{names[column]}': found "
            f"{signals[column][first]}, "
            f"wanted a finite number{more}; correct the row, or delete it and use "
            f"`--resample true` (data.resample: true)"
        )


def _not_uniform(source: Source, grid: Grid, t: np.ndarray) -> RecordingError:
    where = source.place(grid.odd_sample or 0)
    found = f"{source.path}: {where}: time step {grid.step_s:.6g} s, median step {grid.median_step_s:.6g} s"
    if np.any(np.diff(t) <= 0):
        backward = int(np.argmax(np.diff(t) <= 0)) + 1
        return RecordingError(
            f"{source.path}: {source.place(backward)}: time goes from {t[backward - 1]:.9g} s to "
            f"{t[backward]:.9g} s, "
            f"wanted an increase (median step {grid.median_step_s:.6g} s); sort or delete rows, "
            f"or give the sample rate (fs_hz) with time_column null"
        )
    return RecordingError(
        f"{found}, wanted uniform sampling; "
        "`--resample true` (data.resample: true) interpolates to a uniform grid"
    )


def _interpolated(
    source: Source, grid: Grid, t: np.ndarray, signals: list[np.ndarray]
) -> tuple[np.ndarray, float, list[np.ndarray]]:
    steps = np.diff(t)
    if np.any(steps <= 0):
        raise _not_uniform(source, grid, t)
    usual = np.abs(steps - grid.median_step_s) < 0.5 * grid.median_step_s
    rate = round_rate(float(steps[usual].mean()), 1e-3)
    longest = int(np.argmax(steps))
    if steps[longest] > 3 * grid.median_step_s:
        warnings.warn(
            f"{source.path}: {source.place(longest + 1)}: a gap of {steps[longest]:.3g} s "
            f"({100 * steps[longest] / (t[-1] - t[0]):.2g} % of the recording) is filled with a "
            "straight line; "
            f"leave that part out if it matters",
            RecordingWarning,
            stacklevel=4,
        )
    samples = int(np.floor((t[-1] - t[0]) * rate + 1e-6)) + 1
    uniform = t[0] + np.arange(samples) / rate
    return uniform, rate, [np.interp(uniform, t, signal) for signal in signals]
