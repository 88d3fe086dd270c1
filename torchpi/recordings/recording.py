"""Recorded voltage and displacement: reading from a file, checking, cutting, resampling and writing.

A recording holds the voltage in V, the displacement in µm and the time in s, and is uniformly sampled.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from torchpi.errors import RecordingError, is_number, is_positive, kind_of
from torchpi.files import file_sha256, write_columns
from torchpi.recordings.checks import MIN_SAMPLES, check_recording
from torchpi.recordings.faults import least_step
from torchpi.recordings.options import (
    INPUT_COLUMN,
    OUTPUT_COLUMN,
    SIMULATED_COLUMN,
    TIME_COLUMN,
    RecordingOptions,
)
from torchpi.recordings.readers import Source, open_source
from torchpi.recordings.readers.memory import MemorySource, frame_columns
from torchpi.recordings.resampling import to_rate
from torchpi.recordings.shown import Shown
from torchpi.recordings.time_base import (
    column_of,
    converted,
    rate_of,
    read_uniform,
    scale_of,
    simulated_column,
)

__all__ = [
    "Recording",
    "RecordingOptions",
    "check_recording",
    "read_recording",
    "write_recording",
]

MOST_RESAMPLED = 1000  # largest ratio of sample rates, up or down


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Shown):
    """Voltage and displacement of one run of a stage, uniformly sampled, as `read_recording` returns them.

    Raises:
        RecordingError: If signals are not arrays of one length; from the methods, if an interval or fraction
            holds no samples, or the signals cannot be resampled to a rate.
    """

    name: str
    """The file's name without its suffix."""
    t: np.ndarray
    """(time,), s."""
    u: np.ndarray
    """(time,), V: the controller's voltage, held between samples."""
    y: np.ndarray
    """(time,), µm."""
    fs_hz: float
    aux: dict[str, np.ndarray] = field(default_factory=dict)
    """Other recorded signals, (time,), each in its own unit, by column name, `aux_…`."""
    source: str = ""
    """The path as it was given."""
    sha256: str = ""
    """SHA-256 hash of the file's bytes."""
    simulated: np.ndarray | None = None
    """(time,), µm: displacement simulated from this voltage; None if nothing was simulated."""
    as_read: np.ndarray | None = None
    """(readings,), µm: the displacement as read, if `y` was interpolated from it."""
    filled: np.ndarray | None = None
    """(time,), bool: samples filled in because readings are missing; None if none are missing."""
    late_s: np.ndarray | None = None
    """(time,), s: how much later than on a regular clock each sample was taken, by its time stamp; None if
    the stamps are regular, or lost with a change of the rate."""

    def __post_init__(self) -> None:
        self._expect(is_positive(self.fs_hz), "fs_hz", self.fs_hz, "a rate over 0 Hz")
        self._expect(isinstance(self.aux, Mapping), "aux", self.aux, "signals by name")
        for name, signal in (("t", self.t), *self._signals().items()):
            if not (isinstance(signal, np.ndarray) and signal.ndim == 1):
                raise RecordingError(
                    f"{self.source or self.name}: {name}: found {kind_of(signal)}, expected a NumPy array "
                    "(time,): Recording.from_arrays makes a recording of anything that NumPy accepts"
                )
        lengths = {"t": len(self.t), "u": len(self.u), "y": len(self.y)}
        lengths |= {name: len(signal) for name, signal in self.aux.items()}
        lengths |= {name: len(signal) for name, signal in self._optional().items()}
        if len(set(lengths.values())) > 1:
            found = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise RecordingError(
                f"{self.source or self.name}: unequal lengths: {found} samples; cut them to one length"
            )

    @classmethod
    def from_arrays(
        cls,
        t: npt.ArrayLike | None,  # (time,), s
        u: npt.ArrayLike,  # (time,), V
        y: npt.ArrayLike,  # (time,), µm
        *,
        name: str = "arrays",
        aux: Mapping[str, npt.ArrayLike] | None = None,
        allow_constant_input: bool = False,
        **changes: Any,
    ) -> "Recording":
        """Make a recording of voltage and displacement in memory, with the same checks and options as a file.

        Args:
            t: Time stamps, uniform; None if `fs_hz` gives the sample rate. All arrays are copied.
            u: Voltage of the controller.
            y: Displacement.
            name: Name of the recording in errors and reports.
            aux: Other signals (time,), by names that begin with `aux_`.
            allow_constant_input: Accept a hold.
            changes: Single options of `RecordingOptions`: `fs_hz`, `input_unit`, `output_unit`, `time_unit`,
                `resample`, `zero`, `skip_s`.

        Raises:
            RecordingError: States in one line what is wrong, at which index, and what to do.
            ConfigError: An option that does not exist.

        Warns:
            RecordingWarning: See `check_recording`.

        Example:
            >>> import numpy as np
            >>> from torchpi import Recording
            >>> t = np.arange(2000) / 1000
            >>> u = 5 - 5 * np.cos(2 * np.pi * t)
            >>> Recording.from_arrays(t, 1e3 * u, 0.8 * u, input_unit="mV")
            Recording('arrays', 2,000 samples at 1000 Hz, 2 s, u 0…10 V, y 0…8 µm)
        """
        options = RecordingOptions("t" if t is not None else None, "u", "y").with_changes(**changes)
        if t is None and options.fs_hz is None:
            raise RecordingError(f"{name}: found neither t nor fs_hz, expected one of them")
        if aux is not None and not isinstance(aux, Mapping):
            raise RecordingError(f"{name}: aux: found {kind_of(aux)}, expected signals by name")
        for key in aux or {}:
            if not str(key).startswith("aux_"):
                raise RecordingError(
                    f"{name}: aux: found {key!r}, expected a name that begins with aux_: 'aux_{key}'"
                )
        arrays = {"u": u, "y": y, **(aux or {})} | ({} if t is None else {"t": t})
        return _recording_of(
            MemorySource(name, arrays), options, name, allow_constant_input=allow_constant_input
        )

    @classmethod
    def from_frame(
        cls, frame: Any, *, name: str = "frame", allow_constant_input: bool = False, **changes: Any
    ) -> "Recording":
        """Make a recording of columns of a pandas frame, found by name and unit like those of a file.

        Args:
            frame: Anything with `columns` and `index`, such as a `pandas.DataFrame`. The index counts as a
                column if it has a name or holds dates.
            name: Name of the recording in errors and reports.
            allow_constant_input: Accept a hold.
            changes: Single options of `RecordingOptions`, such as `input_column="Command [mV]"`.

        Raises, Warns:
            As `from_arrays`.
        """
        source = MemorySource(name, frame_columns(name, frame), "iloc")
        options = RecordingOptions().with_changes(**changes)
        return _recording_of(source, options, name, allow_constant_input=allow_constant_input)

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
        """Return the samples with start_s ≤ t < stop_s by the file's time stamps, which they keep."""
        for name, time_s in (("start_s", start_s), ("stop_s", stop_s)):
            self._expect(is_number(time_s), name, time_s, "a time in s")
        edge = 1e-3 / self.fs_hz  # rounding may put a stamp that should equal the edge just beside it
        first, last = np.searchsorted(self.t, [start_s - edge, stop_s - edge])
        if first >= last:
            raise RecordingError(
                f"{self.source or self.name}: no samples from {start_s:g} s to {stop_s:g} s, "
                f"the recording runs from {self.t[0]:g} s to {self.t[-1]:g} s; choose times inside it"
            )
        return self._cut(int(first), int(last))

    def split_tail(self, fraction: float) -> tuple["Recording", "Recording"]:
        """Split off the last `fraction` as (head, tail). Random samples would leak: neighbours are alike."""
        self._expect(is_number(fraction), "fraction", fraction, "a number between 0 and 1")
        tail = round(len(self) * fraction)
        if not 0 < tail < len(self):
            raise RecordingError(
                f"{self.source or self.name}: a tail of {fraction:g} of {len(self)} samples leaves "
                "one part empty, expected a fraction between 0 and 1; choose another"
            )
        return self._cut(0, len(self) - tail), self._cut(len(self) - tail, len(self))

    def with_zero(self, zero: Literal["recorded", "first"]) -> "Recording":
        """Count the displacement from its first sample (`first`): a sensor's own zero is often arbitrary."""
        return replace(self, y=self.y - self.y[0]) if zero == "first" else self

    @property
    def output_step_um(self) -> float:
        """The smallest difference between readings that exceeds rounding: the sensor's step."""
        return least_step(self.readings)

    @property
    def readings(self) -> np.ndarray:
        """(readings,), µm: the values from the sensor, before any interpolation."""
        return self.y if self.as_read is None else self.as_read

    @property
    def not_read(self) -> np.ndarray:
        """Indices of samples that were filled in, and of the next, which respond to a filled-in voltage."""
        if self.filled is None:
            return np.zeros(0, dtype=int)
        behind = np.concatenate([[False], self.filled[:-1]])
        return np.flatnonzero(self.filled | behind)

    def resampled(self, fs_hz: float) -> "Recording":
        """Return the same signals at another rate, without aliasing and without delay.

        Signals are treated as band-limited below half the lower rate, including the voltage, which a
        converter holds: the half sample of delay that the hold adds belongs to the rate of recording.
        """
        self._expect(is_positive(fs_hz), "fs_hz", fs_hz, "a rate over 0 Hz")
        if not 1 / MOST_RESAMPLED <= fs_hz / self.fs_hz <= MOST_RESAMPLED:
            raise RecordingError(
                f"{self.source or self.name}: cannot resample from {self.fs_hz:g} Hz to {fs_hz:g} Hz, "
                f"expected a rate within a factor of {MOST_RESAMPLED}; correct fs_hz or time_unit"
            )
        if fs_hz == self.fs_hz:
            return self
        samples = int(np.floor((len(self) - 1) * fs_hz / self.fs_hz + 1e-6)) + 1
        convert = {
            name: to_rate(signal, self.fs_hz, fs_hz, samples) for name, signal in self._signals().items()
        }
        u, y, simulated = convert.pop("u"), convert.pop("y"), convert.pop("simulated", None)
        t = self.t[0] + np.arange(samples) / fs_hz
        changed = {"t": t, "u": u, "y": y, "fs_hz": float(fs_hz), "aux": convert, "simulated": simulated}
        if self.filled is not None:
            changed["filled"] = np.interp(t, self.t, self.filled) > 0
        return replace(self, **changed, as_read=self.readings, late_s=None)

    def _expect(self, holds: bool, name: str, found: object, expected: str) -> None:
        if not holds:
            raise RecordingError(f"{self.source or self.name}: {name}: found {found!r}, expected {expected}")

    def _signals(self) -> dict[str, np.ndarray]:
        simulated = {} if self.simulated is None else {"simulated": self.simulated}
        return {"u": self.u, "y": self.y, **simulated, **self.aux}

    def _optional(self) -> dict[str, Any]:
        optional = {"simulated": self.simulated, "filled": self.filled, "late_s": self.late_s}
        return {name: signal for name, signal in optional.items() if signal is not None}

    def _cut(self, first: int, last: int) -> "Recording":
        cut = slice(first, last)
        aux = {name: signal[cut] for name, signal in self.aux.items()}
        optional = {name: signal[cut] for name, signal in self._optional().items()}
        return replace(self, t=self.t[cut], u=self.u[cut], y=self.y[cut], aux=aux, **optional)


def read_recording(
    path: str | Path,
    options: RecordingOptions | None = None,
    *,
    min_samples: int = MIN_SAMPLES,
    allow_constant_input: bool = False,
    simulated: bool = False,
    **changes: Any,
) -> Recording:
    """Read voltage and displacement from a file and check them.

    The suffix gives the kind: text (.csv .txt .dat .tsv .asc .lvm), .npy, .npz, .mat, and with the extra
    `torchpi[io]` .h5 .hdf5 .tdms .mf4 .mdf and the .mat of version 7.3. Columns `aux_…` are read too.

    Args:
        path: the file.
        options: which columns, in which units; by default `time_s,input_v,output_um`.
        min_samples: the fewest samples that the model needs.
        allow_constant_input: accept a hold.
        simulated: read the column `simulated_um` as well.
        changes: single options of `RecordingOptions`, such as `input_column="u"`.

    Raises:
        RecordingError: states in one line what is wrong, in which row and column, and what to do.
        ConfigError: an option that does not exist.

    Warns:
        RecordingWarning: see `check_recording`.

    Example:
        >>> from torchpi import Recording, read_recording, write_recording
        >>> triangle = Recording.from_arrays(None, [0, 5, 10, 5] * 50, [0, 4, 8, 4] * 50, fs_hz=100)
        >>> write_recording("slow.csv", triangle)
        >>> read_recording("slow.csv")
        Recording('slow', 200 samples at 100 Hz, 2 s, u 0…10 V, y 0…8 µm)
    """
    options = RecordingOptions.of(options, changes)
    return _recording_of(
        open_source(path),
        options,
        Path(path).stem,
        sha256=file_sha256(path),
        min_samples=min_samples,
        allow_constant_input=allow_constant_input,
        simulated=simulated,
    )


def _recording_of(
    source: Source,
    options: RecordingOptions,
    name: str,
    *,
    sha256: str | None = None,  # by default the hash of the samples
    min_samples: int = MIN_SAMPLES,
    allow_constant_input: bool = False,
    simulated: bool = False,
) -> Recording:
    """Make a recording, as `read_recording` does, of an open file or of signals in memory."""
    names = [column_of(source, options.input_column, "input")]
    names.append(column_of(source, options.output_column, "output"))
    if names[0] == names[1]:
        raise RecordingError(
            f"{source.path}: input and output are the same column '{names[0]}', expected two; "
            f"choose with input_column and output_column"
        )
    scale_u = scale_of(source, names[0], "input", options.input_unit)
    scale_y = scale_of(source, names[1], "output", options.output_unit)
    aux_names = [name for name in source.names if name.startswith("aux_") and name not in names]
    simulated_names = [simulated_column(source)] if simulated else []
    read = read_uniform(source, names + simulated_names + aux_names, options, min_samples)
    u, y, *others = read.signals
    of_simulator = None
    if simulated:
        of_simulator = converted(others.pop(0), scale_of(source, simulated_names[0], "output", None))
    recording = Recording(
        name=name,
        t=read.t,
        u=converted(u, scale_u),
        y=converted(y, scale_y),
        fs_hz=read.fs_hz,
        aux=dict(zip(aux_names, others, strict=True)),
        simulated=of_simulator,
        as_read=None if read.rows is None else converted(read.rows[1], scale_y),
        filled=read.filled,
        late_s=read.late_s,
        source=source.path,
        sha256=sha256 or samples_sha256(u, y),
    ).with_zero(options.zero)
    if options.skip_s > 0:
        recording = recording.slice(recording.t[0] + options.skip_s, np.inf)
    first = len(read.t) - len(recording)
    check_recording(
        recording,
        min_samples=min_samples,
        allow_constant_input=allow_constant_input,
        check_start=options.skip_s == 0,
        place=None if read.rows else lambda index: source.place(index + first),
    )
    wanted_hz = rate_of(source, options.fs_hz)
    return recording.resampled(wanted_hz) if wanted_hz and wanted_hz != read.fs_hz else recording


def write_recording(path: str | Path, recording: Recording, input_column: str = INPUT_COLUMN) -> None:
    """Write `time_s,input_v,output_um[,simulated_um][,aux_…]` as CSV, every double exact.

    Args:
        path: The file; an existing one is replaced. It is written whole or not at all.
        recording: What is written.
        input_column: Name of the column of the voltage.

    Raises:
        RecordingError: If `recording` is not a `Recording`.
        ArtifactError: If the path cannot be written.
    """
    if not isinstance(recording, Recording):
        raise RecordingError(
            f"recording: found {kind_of(recording)}, expected a Recording: "
            "Recording.from_arrays and Recording.from_frame make one"
        )
    others = dict(recording.aux)
    if recording.simulated is not None:
        others = {SIMULATED_COLUMN: recording.simulated, **others}
    columns = [recording.t, recording.u, recording.y, *others.values()]
    names = [TIME_COLUMN, input_column, OUTPUT_COLUMN, *others]
    write_columns(path, names, (np.asarray(c, dtype=np.float64).tolist() for c in columns))


def samples_sha256(u: np.ndarray, y: np.ndarray) -> str:
    """Return the hash of a voltage and a displacement that were not read from a file."""
    return hashlib.sha256(u.tobytes() + y.tobytes()).hexdigest()
