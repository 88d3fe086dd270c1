"""A recording of a simulated stage of several axes: `torchpi simulate`."""

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
"""Of the voltages, in units of the widest threshold of the inputs' plays, which is their rms in a fit."""
BAND = 0.4
"""Of the sample rate, that is excited."""


def simulate_axes(
    path: Path,
    excitation: str,
    output: Path,
    duration_s: float | None,
    seed: int,
    options: Mapping[str, Any],
) -> MultiAxisRecording:
    """Play an excitation of random phases on every input, and write what the stage does, without noise.

    Args:
        path: Of a stage of several axes.
        excitation: One that has random phases: others move all inputs in proportion.
        output: CSV to write.
        duration_s: As for one axis.
        seed: Of the first input; the next has the next.
        options: Of the excitation; its voltages are those that were fitted, by default.

    Raises:
        ArtifactError: A file with another stage.
        ConfigError: An excitation without random phases, or an option that it does not have.
        StageError: Voltages without a bounded answer.
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
