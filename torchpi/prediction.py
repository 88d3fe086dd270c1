"""What a stage does with a voltage in a file: `torchpi predict`."""

from pathlib import Path

import numpy as np
import torch

from torchpi.errors import RecordingError
from torchpi.recordings.readers import open_source
from torchpi.recordings.recording import Recording, RecordingOptions, read_signal, write_recording
from torchpi.stage import Stage

AT_A_TIME = 1 << 16
"""Samples that are predicted at a time: memory beside the signals themselves does not grow with the file."""


def predict_file(
    stage: str | Path, recording: str | Path, output: str | Path, options: RecordingOptions | None = None
) -> Recording:
    """Read time_s,input_v[,aux_…], write the same with output_um: `predict` over a file.

    Args:
        stage: the file that a diagnosis left.
        recording: a file of any kind that `read_recording` reads.
        output: CSV to write.
        options: which column is the voltage, in which unit; those of the displacement are of no use here.

    Raises:
        ArtifactError: `stage` is no stage file.
        RecordingError: A column is missing, or is not as expected.
        StageError: The stage has no meaning at the file's sample rate.
    """
    loaded = Stage.load(stage)
    options = options or RecordingOptions()
    u = read_signal(
        recording, options.input_column, option="input_column", options=options, unit=options.input_unit
    )
    names = [name for name in open_source(recording).names if name.startswith("aux_")]
    for name in loaded.aux_names:
        if name not in names:
            raise RecordingError(
                f"{recording}: no column '{name}', which {stage} takes; expected it beside the input"
            )
    aux = {name: read_signal(recording, name, options=options, unit="V").x for name in names}
    y = predict(loaded.at_sample_rate(u.fs_hz), u.x, aux)
    predicted = Recording(u.name, u.t, u.x, y, u.fs_hz, aux)
    write_recording(output, predicted)
    return predicted


def predict(
    stage: Stage,
    u: np.ndarray,  # (time,), V
    aux: dict[str, np.ndarray],  # (time,) each
) -> np.ndarray:  # (time,), µm
    """The reading from the de-energised state, at the stage's own rate, without noise or converters."""
    y, state, of_sensor = np.empty(len(u)), None, None
    with torch.no_grad():
        for first in range(0, len(u), AT_A_TIME):
            part = slice(first, first + AT_A_TIME)
            signals = {name: _row(aux[name][part]) for name in stage.aux_names}
            displacement, state = stage(_row(u[part]), state, signals)
            reading, of_sensor = stage.sensor(displacement, of_sensor)
            y[part] = reading[0].numpy()
    return y


def _row(x: np.ndarray) -> torch.Tensor:
    return torch.tensor(x, dtype=torch.float64)[None]
