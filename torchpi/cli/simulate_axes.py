"""Record a simulated stage of several axes: `torchpi simulate`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchpi.cli.run_axes import axes_stage
from torchpi.errors import ConfigError
from torchpi.excitation.signals import make_excitation
from torchpi.recordings.multi_axis import MultiAxisRecording, write_multi_axis

PEAK = 3.0
"""Peak voltage in units of the widest threshold of the input plays, which is the rms voltage of a fit."""
BAND = 0.4
"""Excited band as a fraction of the sample rate."""


def simulate_axes(
    path: Path,
    excitation: str,
    output: Path,
    duration_s: float | None,
    seed: int,
    options: Mapping[str, Any],
) -> MultiAxisRecording:
    """Apply an excitation with random phases to every input, and write the noise-free response of the stage.

    Args:
        path: File of a stage of several axes.
        excitation: One with random phases, because others move all inputs in proportion.
        output: CSV to write.
        duration_s: Length of the recording, s, with the default for one axis.
        seed: Seed of the first input; each further input has the next one.
        options: Options of the excitation; by default its voltages are those of the fit.

    Raises:
        ArtifactError: The file has another stage.
        ConfigError: The excitation has no random phases, or not this option.
        StageError: The response to the voltages is unbounded.
    """
    stage = axes_stage(path)
    if excitation != "multisine":
        raise ConfigError(
            f"--excitation: found {excitation}, which moves all inputs in proportion; expected multisine for "
            "several axes"
        )
    peak_v = PEAK * max(stage.input_thresholds_v, default=1.0)
    given = {"low_v": -peak_v, "high_v": peak_v, "high_hz": BAND * stage.sample_rate_hz, "ramp_in_s": 0.0}
    given |= options
    each = [
        make_excitation(excitation, stage.sample_rate_hz, duration_s, seed + i, given)[1]
        for i in range(stage.inputs)
    ]
    u = np.stack(each, 1)
    y = stage.simulate(torch.from_numpy(u)[None])[0].numpy()
    recorded = MultiAxisRecording(output.stem, u, y, stage.sample_rate_hz)
    write_multi_axis(output, recorded)
    print(
        f"{output}: {excitation} on {path}, {len(u):,} samples at {stage.sample_rate_hz:g} Hz, "
        f"{stage.inputs} inputs of {u.std():.3g} V rms, {stage.outputs} outputs of {y.std():.3g} µm rms"
    )
    return recorded
