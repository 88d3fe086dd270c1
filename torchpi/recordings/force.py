"""Recordings of an oscillator, whose input is a force."""

import warnings
from pathlib import Path

from torchpi.errors import RecordingWarning
from torchpi.recordings.options import FORCE_COLUMN, INPUT_COLUMN, RecordingOptions
from torchpi.recordings.readers import open_source
from torchpi.recordings.recording import Recording, read_recording


def with_force(path: str | Path, options: RecordingOptions) -> RecordingOptions:
    """Return the options with `force_n` as the input, if the file has it and no other column is named."""
    has_force = options.input_column == INPUT_COLUMN and FORCE_COLUMN in open_source(path).names
    return options.with_changes(input_column=FORCE_COLUMN) if has_force else options


def read_force_recording(path: str | Path, options: RecordingOptions) -> Recording:
    """Read a recording of force, N, in place of the voltage, and displacement, µm.

    Raises:
        RecordingError: As `read_recording`.

    Warns:
        RecordingWarning: As `read_recording`, except about units, since they are not those of a piezo.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message=".*give (input|output|time)_unit", category=RecordingWarning
        )
        return read_recording(path, with_force(path, options))
