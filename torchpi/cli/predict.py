"""Predict the response of a stage to a voltage from a file: `torchpi predict`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from torchpi.errors import ConfigError, RecordingError, SimulationError
from torchpi.recordings.force import with_force
from torchpi.recordings.multi_axis import MultiAxisRecording, read_multi_axis, write_multi_axis
from torchpi.recordings.options import FORCE_COLUMN, INPUT_COLUMN, SIMULATED_COLUMN
from torchpi.recordings.readers import open_source
from torchpi.recordings.recording import Recording, RecordingOptions, write_recording
from torchpi.recordings.signal import read_signal
from torchpi.recordings.time_base import simulated_column
from torchpi.simulators import COLUMN, load_simulator
from torchpi.stage import Stage
from torchpi.stage.bouc_wen_oscillator import BoucWenOscillator
from torchpi.stage.kinds import load_own_kind
from torchpi.stage.multi_axis import MultiAxisStage
from torchpi.stage.multi_axis.stage import RATE_TOLERANCE

AT_A_TIME = 1 << 16
"""Number of samples predicted at a time, so that memory beyond the signals does not grow with the file."""


def predict_file(
    stage: str | Path,
    recording: str | Path,
    output: str | Path,
    options: RecordingOptions | None = None,
    simulation: str | None = None,
    periodic: bool = False,
) -> Recording | MultiAxisRecording:
    """Read time_s,input_v[,aux_…] and write the same with output_um: `predict` over a file.

    For a stage of several axes the columns are time_s,input_1_v,input_2_v,… and output_1_um,output_2_um,…;
    for an oscillator they are time_s,force_n or, with one newton per volt, time_s,input_v.

    Args:
        stage: the stage file of a diagnosis.
        recording: a file in any format that `read_recording` reads.
        output: CSV to write.
        options: which column is the voltage, and its unit; options of the displacement have no effect.
        simulation: the simulation that a correcting stage calls; its file only names it and loads no code.
        periodic: the file is one period of a periodic input, and the steady state is predicted; for an
            oscillator only.

    Raises:
        ArtifactError: `stage` is not a stage file.
        ConfigError: A steady state is requested of a stage other than an oscillator.
        RecordingError: A column is missing, or is not as expected.
        SimulationError: The stage corrects a simulation that was not given, or that fails.
        StageError: The stage is not valid at the sample rate of the file.
    """
    own = load_own_kind(stage)
    if isinstance(own, BoucWenOscillator):
        if simulation is not None:
            raise calls_nothing(str(stage), simulation)
        return predict_oscillator(own, recording, output, options or RecordingOptions(), periodic)
    if periodic:
        raise ConfigError(
            f"{stage}: found a stage that starts at rest, expected an oscillator with --periodic"
        )
    if own is not None:
        return predict_multi_axis(own, str(stage), recording, output, options, simulation)
    loaded = with_simulation(Stage.load(stage), str(stage), simulation)
    options = options or RecordingOptions()
    u = read_signal(
        recording, options.input_column, option="input_column", options=options, unit=options.input_unit
    )
    source = open_source(recording)
    names = [name for name in source.names if name.startswith("aux_")]
    for name in loaded.aux_names:
        if name not in [*names, SIMULATED_COLUMN]:
            raise RecordingError(
                f"{recording}: no column '{name}', which {stage} needs; expected it beside the input"
            )
    aux = {name: read_signal(recording, name, options=options, unit="V").x for name in names}
    simulated = None
    if SIMULATED_COLUMN in loaded.aux_names:
        simulated = read_signal(recording, simulated_column(source), options=options).x
    signals = aux if simulated is None else {**aux, SIMULATED_COLUMN: simulated}
    y = predict(loaded.at_sample_rate(u.fs_hz), u.x, signals)
    predicted = Recording(u.name, u.t, u.x, y, u.fs_hz, aux, simulated=simulated)
    write_recording(output, predicted)
    return predicted


def predict_multi_axis(
    stage: MultiAxisStage,
    path: str,
    recording: str | Path,
    output: str | Path,
    options: RecordingOptions | None,
    simulation: str | None,
) -> MultiAxisRecording:
    """Read time_s,input_1_v,input_2_v,… and write the same with output_1_um,output_2_um,…, from rest.

    For the steady state of a periodic input, the file must include one additional period at its start.

    Raises:
        RecordingError: The number of inputs or the sample rate differs.
        SimulationError: A simulation was given, which such a stage does not call.
    """
    if simulation is not None:
        raise calls_nothing(path, simulation)
    given = read_multi_axis(recording, options)
    if given.u.shape[1] != stage.inputs:
        raise RecordingError(
            f"{recording}: found {given.u.shape[1]} inputs, expected {stage.inputs} as in {path}"
        )
    if differs := stage.mismatch(stage.inputs, stage.outputs, given.fs_hz):
        raise RecordingError(f"{recording}: {differs} {path}")
    y = stage.simulate(torch.from_numpy(given.u)[None])[0].numpy()
    predicted = replace(given, y=y)
    write_multi_axis(output, predicted)
    return predicted


def predict_oscillator(
    oscillator: BoucWenOscillator,
    recording: str | Path,
    output: str | Path,
    options: RecordingOptions,
    periodic: bool,
) -> Recording:
    """Read time_s,force_n or time_s,input_v and write the same with output_um.

    Raises:
        RecordingError: A column is missing, or is not as expected.
        StageError: The oscillator is not valid at the sample rate of the file, or diverges.
    """
    options = with_force(recording, options)
    u = read_signal(
        recording, options.input_column, option="input_column", options=options, unit=options.input_unit
    )
    # Time stamps with few digits give the rate only roughly, but a resonance needs it exactly.
    same = abs(u.fs_hz - oscillator.sample_rate_hz) <= RATE_TOLERANCE * oscillator.sample_rate_hz
    at_rate = oscillator if same else oscillator.at_sample_rate(u.fs_hz)
    y = at_rate.simulate(torch.from_numpy(u.x)[None], periodic)[0].numpy()
    predicted = Recording(u.name, u.t, u.x, y, u.fs_hz)
    write_recording(output, predicted, FORCE_COLUMN if options.input_column == FORCE_COLUMN else INPUT_COLUMN)
    return predicted


def with_simulation(stage: Stage, path: str, simulation: str | None) -> Stage:
    """Return the stage with the simulation that it calls, if it calls one.

    Args:
        stage: The stage as in its file.
        path: Path of the file.
        simulation: The given simulation.

    Raises:
        SimulationError: The stage needs a simulation and none is given, or vice versa.
    """
    calls = stage.simulation if stage.simulation != COLUMN else ""
    if simulation in (None, COLUMN) and calls:
        raise SimulationError(
            f"{path}: found a stage that corrects the simulation '{calls}', expected it as well; "
            f"add --simulation {calls}"
        )
    if simulation in (None, stage.simulation) and not calls:
        return stage
    if not calls:
        raise calls_nothing(path, simulation)
    return stage.with_simulation(load_simulator(str(simulation)))


def calls_nothing(path: str, simulation: str | None) -> SimulationError:
    """Return the error for a simulation given to a stage that calls none."""
    return SimulationError(
        f"{path}: found a stage that calls no simulation, expected no --simulation {simulation}"
    )


def predict(
    stage: Stage,
    u: np.ndarray,  # (time,), V
    aux: dict[str, np.ndarray],  # (time,) each
) -> np.ndarray:  # (time,), µm
    """Return the reading from the de-energised state at the stage's own rate, without noise or converters."""
    y, state, of_sensor = np.empty(len(u)), None, None
    at_a_time = len(u) if stage.simulation else AT_A_TIME  # a simulation is called with whole records
    with torch.no_grad():
        for first in range(0, len(u), at_a_time):
            part = slice(first, first + at_a_time)
            signals = {name: _row(aux[name][part]) for name in stage.aux_names}
            displacement, state = stage(_row(u[part]), state, signals)
            reading, of_sensor = stage.sensor(displacement, of_sensor)
            y[part] = reading[0].numpy()
    return y


def _row(x: np.ndarray) -> torch.Tensor:
    return torch.tensor(x, dtype=torch.float64)[None]
