"""Export a stage of several axes and its inverse from a training run: `torchpi export`."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torchpi.control.multi_axis import MultiAxisInverse, linear_inverses
from torchpi.errors import ArtifactError
from torchpi.export.formats import write_together
from torchpi.export.multi_axis import FORMATS, multi_axis_files
from torchpi.stage.beside import exported_stage
from torchpi.stage.multi_axis import MultiAxisStage

BAND = 0.05
"""Default band of the trajectories, as a fraction of the sample rate."""
BEYOND = 1.5
"""Ratio of the largest accepted desired displacement to the largest recorded one."""


def export_axes(
    stage: MultiAxisStage, run: Path, output: Path, formats: Sequence[str] | None, band_hz: float | None
) -> list[Path]:
    """Write the inverse as NAME, the stage as a step as NAME_forward, and the stage as NAME_stage.pt.

    If the numbers of outputs and inputs differ there is no inverse; it is left out, with a message.

    Args:
        stage: The stage of the run.
        run: Folder of the run.
        output: Path without suffix.
        formats: Some of `FORMATS`; all of them by default.
        band_hz: Band of the trajectories; `BAND` times the sample rate by default.

    Raises:
        ArtifactError: The run lacks the ranges of its recordings, or the name cannot be used in C.
        ConfigError: A format is unknown.
        StageError: The band exceeds that of the filters.
    """
    formats = FORMATS if formats is None else formats
    files = multi_axis_files(stage, output.with_name(f"{output.name}_forward"), formats)
    files[exported_stage(output)] = stage.save
    backward = f"no inverse: found {stage.inputs} inputs and {stage.outputs} outputs, expected equal numbers"
    if stage.inputs == stage.outputs:
        inverse = inverse_of(stage, run, band_hz)
        files |= multi_axis_files(inverse, output, formats)
        backward = f"{output.name}: step(y_d at t + {inverse.preview} samples, µm) -> V"
    write_together(files)
    print(backward)
    print(f"{output.name}_forward: step(u at t + {stage.delay_samples} samples, V) -> µm")
    print(f"every {1 / stage.sample_rate_hz:g} s:")
    return list(files)


def inverse_of(stage: MultiAxisStage, run: Path, band_hz: float | None) -> MultiAxisInverse:
    """Return the inverse at the middle recorded amplitude, limited to the recorded voltages."""
    every = recorded(run / "metrics.json")
    levels = sorted(float(one["input_rms_v"]) for one in every)
    volts = np.array([one["input_range_v"] for one in every])
    moved = np.array([one["output_range_um"] for one in every])
    band = BAND * stage.sample_rate_hz if band_hz is None else band_hz
    return MultiAxisInverse(
        stage,
        *linear_inverses(stage, levels[len(levels) // 2], band),
        limits_v=np.stack([volts[:, :, 0].min(0), volts[:, :, 1].max(0)], 1),
        accepted_um=BEYOND * np.abs(moved - stage.offset()[:, None]).max((0, 2)),
    )


def recorded(path: Path) -> list[dict[str, Any]]:
    """Read the metrics of each recording of a run.

    Raises:
        ArtifactError: The file is missing, or is not what `train fit` writes.
    """
    try:
        metrics = json.loads(path.read_text(encoding="utf-8"))
        every = [one for part in ("train", "heldout") for one in metrics[part]]
        if all({"input_rms_v", "input_range_v", "output_range_um"} <= set(one) for one in every) and every:
            return every
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ArtifactError(
            f"{path}: not readable, expected the metrics of the run beside its stage"
        ) from error
    raise ArtifactError(f"{path}: found no recorded ranges, expected a run of this version")
