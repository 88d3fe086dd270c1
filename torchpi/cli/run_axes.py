"""Run an exported inverse of several axes against a simulated stage: `torchpi run`."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchpi.cli.export_axes import BAND
from torchpi.control.multi_axis import MultiAxisInverse
from torchpi.errors import ArtifactError, ConfigError, RecordingError
from torchpi.export.multi_axis.numbers import read_inverse
from torchpi.files import check_output_folder, write_text
from torchpi.loop.axes import AxesTracking, random_axes, track_axes
from torchpi.recordings.multi_axis import DESIRED, columns
from torchpi.recordings.options import RecordingOptions
from torchpi.recordings.readers import open_source
from torchpi.recordings.signal import read_signal
from torchpi.stage.beside import exported_stage
from torchpi.stage.kinds import load_axes
from torchpi.stage.multi_axis import MultiAxisStage

RANDOM, RANDOM_S = "random", 3.0


def run_axes(
    numbers: Path, stage: Path | None, trajectory: str | Sequence[str] | None, output: Path
) -> list[AxesTracking]:
    """Drive the stage along each trajectory, print the remaining error, and write loop.json.

    The numbers of NAME.json are run; the steps of NAME.pt and NAME.c give the same bits.

    Args:
        numbers: NAME.json, with NAME_stage.pt beside it.
        stage: File of the plant; by default NAME_stage.pt.
        trajectory: CSVs with columns time_s,yd_1_um,yd_2_um,…, or random.
        output: Folder for loop.json.

    Raises:
        ArtifactError: Files are damaged, or do not belong together.
        ConfigError: A trajectory does not exist.
        RecordingError: A trajectory cannot be used.
        StageError: The stage has other axes.
    """
    check_output_folder(output)
    inverse = read_inverse(numbers, axes_stage(exported_stage(numbers.with_suffix(""))))
    plant = inverse.stage if stage is None else axes_stage(stage)
    names = (
        [RANDOM] if trajectory is None else [trajectory] if isinstance(trajectory, str) else list(trajectory)
    )
    found = []
    for name in names:
        tracked = track_axes(inverse, plant, trajectory_of(name, inverse))
        print(f"{name}:\n{table(tracked)}")
        found.append(tracked)
    path = output / "loop.json"
    content = {name: one.as_json() for name, one in zip(names, found, strict=True)}
    write_text(path, json.dumps(content, indent=1) + "\n")
    print(f"{path}: the same numbers")
    return found


def axes_stage(path: Path) -> MultiAxisStage:
    """Load the stage of several axes from a file.

    Raises:
        ArtifactError: The file has none.
    """
    found = load_axes(path)
    if found is None:
        raise ArtifactError(
            f"{path}: found no stage of several axes, expected one written by 'torchpi export'"
        )
    return found


def trajectory_of(name: str, inverse: MultiAxisInverse) -> np.ndarray:
    """Return the desired displacements of a trajectory, (time, outputs), µm.

    Raises:
        ConfigError: The trajectory does not exist.
        RecordingError: The number of axes or the sample rate differs.
    """
    rate, outputs = inverse.stage.sample_rate_hz, inverse.stage.outputs
    if name == RANDOM:
        return random_axes(inverse, RANDOM_S, BAND * rate)
    if not Path(name).is_file():
        raise ConfigError(f"--trajectory: found {name}, expected a file with columns yd_1_um, …, or {RANDOM}")
    source = open_source(name)
    signals = [
        read_signal(name, one, options=RecordingOptions(), unit="um")
        for one in columns(source, DESIRED, "yd_1_um")
    ]
    if len(signals) != outputs:
        raise RecordingError(f"{name}: found {len(signals)} axes, expected {outputs} as in the compensator")
    if abs(signals[0].fs_hz - rate) > 1e-3 * rate:
        raise RecordingError(
            f"{name}: found {signals[0].fs_hz:g} Hz, expected {rate:g} Hz as in the compensator"
        )
    return np.stack([one.x for one in signals], 1)


def table(tracked: AxesTracking) -> str:
    """Format the errors and coupling of each axis as lines of text."""
    rows = [("axis", "desired rms", "error", "moves others", "linear inverse", "moves others")]
    for k, desired in enumerate(tracked.desired_um):
        rows.append(
            (
                str(k + 1),
                f"{desired:.4g} µm",
                f"{tracked.error_percent[k]:.3g} %",
                f"{max(tracked.coupling_percent[k]):.3g} %",
                f"{tracked.linear_error_percent[k]:.3g} %",
                f"{max(tracked.linear_coupling_percent[k]):.3g} %",
            )
        )
    lines = ["  " + "  ".join(cell.rjust(14) for cell in row) for row in rows]
    counted = f"  held inputs {tracked.held_inputs}, voltages at a limit {tracked.limited_outputs}"
    return "\n".join([*lines, counted])
