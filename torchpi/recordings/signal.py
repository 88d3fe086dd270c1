"""Reading one signal from a file: a trajectory to follow or a voltage to play."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchpi.files import file_sha256
from torchpi.recordings.checks import check_length
from torchpi.recordings.options import RecordingOptions
from torchpi.recordings.readers import open_source
from torchpi.recordings.readers.header import UNITS, Role
from torchpi.recordings.readers.source import Column
from torchpi.recordings.time_base import column_of, converted, read_uniform, scale_of


@dataclass(frozen=True, eq=False)
class Signal:
    """One uniformly sampled signal of a file, as `read_signal` returns it."""

    name: str
    t: np.ndarray
    """(time,), s."""
    x: np.ndarray
    """(time,), µm or V."""
    fs_hz: float
    source: str
    sha256: str


def read_signal(
    path: str | Path,
    column: Column,
    *,
    option: str = "column",
    options: RecordingOptions | None = None,
    unit: float | str | None = None,
    min_samples: int = 2,
    **changes: Any,
) -> Signal:
    """Read one signal, uniformly sampled, from a file of any kind that `read_recording` reads.

    Args:
        path: the file.
        column: name or number (from 1).
        option: name under which the user gave `column`, for the error messages.
        options, changes: as in `read_recording`; only the options for time apply, and `fs_hz` never changes
            the rate.
        unit: V, mV, kV, um, nm, mm, m …; by default as the column states, else V or µm. The signal is
            returned in V or µm.
        min_samples: the fewest samples that are of use.

    Raises:
        RecordingError: states in one line what is wrong and what to do.
    """
    options = RecordingOptions.of(options, changes)
    source = open_source(path)
    is_input = option == "input_column"
    name = column_of(source, column, "input") if is_input else source.find(column, option)
    read = read_uniform(source, [name], options, min_samples)
    if options.skip_s > 0:
        first = int(np.searchsorted(read.t, read.t[0] + options.skip_s))
        read = read._replace(t=read.t[first:], signals=[read.signals[0][first:]])
        check_length(str(path), len(read.t), min_samples)
    known = unit if unit is not None else source.unit(name)
    role: Role = "input" if is_input or known in UNITS["input"] else "output"
    x = converted(read.signals[0], scale_of(source, name, role, unit, "unit"))
    return Signal(Path(path).stem, read.t, x, read.fs_hz, str(path), file_sha256(path))
