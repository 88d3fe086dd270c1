"""Track trajectories with several axes: the error of each axis, and how much one moves the others."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch

from torchpi.control.multi_axis import MultiAxisInverse
from torchpi.errors import StageError
from torchpi.stage.multi_axis import MultiAxisStage

RUN_IN_S = 0.3
"""Duration at the beginning in which the error is not counted."""
EASE_S = 0.1
WITHIN = 0.8
"""Share of the voltage limits that a random trajectory needs."""


@dataclass(frozen=True)
class AxesTracking:
    """Rms values over the trajectory without its beginning, in percent.

    Attributes:
        desired_um: Rms of each desired displacement, µm.
        error_percent: Error of each axis, relative to its desired displacement.
        coupling_percent: [moving][other]: motion of each axis that should stand while one alone moves,
            relative to that one's motion; 0 on the diagonal.
        linear_error_percent: As `error_percent`, with the best linear inverse.
        linear_coupling_percent: As `coupling_percent`, with the best linear inverse.
        held_inputs: Number of samples that the inverse held.
        limited_outputs: Number of samples that the voltage limits changed.
    """

    desired_um: list[float]
    error_percent: list[float]
    coupling_percent: list[list[float]]
    linear_error_percent: list[float]
    linear_coupling_percent: list[list[float]]
    held_inputs: int
    limited_outputs: int

    def as_json(self) -> dict[str, Any]:
        """Return plain numbers by name."""
        return asdict(self)


def track_axes(inverse: MultiAxisInverse, plant: MultiAxisStage, yd: np.ndarray) -> AxesTracking:
    """Drive a stage with an inverse along desired displacements, all axes together and each alone.

    Args:
        inverse: The inverse that drives; the stage in it need not be the plant.
        plant: The stage that is driven.
        yd: (time, outputs), µm.

    Raises:
        StageError: The plant has other axes or another sample rate, or the trajectory is too short.
    """
    model = inverse.stage
    if found := model.mismatch(plant.inputs, plant.outputs, plant.sample_rate_hz):
        raise StageError(f"stage: {found} the compensator")
    first, last = int(RUN_IN_S * plant.sample_rate_hz), plant.delay_samples
    if yd.shape[1:] != (model.outputs,) or len(yd) < 2 * first:
        raise StageError(
            f"trajectory: found an array of shape {yd.shape}, expected at least {2 * first} samples of "
            f"{model.outputs} axes"
        )
    linear = MultiAxisInverse(
        model, inverse.first, inverse.corrections, 0, inverse.limits_v, inverse.accepted_um
    )

    def rms(x: np.ndarray) -> np.ndarray:
        return np.asarray(np.sqrt(np.square(x[first:-last]).mean(0)))

    def moved(by: MultiAxisInverse, desired: np.ndarray) -> np.ndarray:
        by.reset()
        u = by.block(np.concatenate([desired, np.zeros((by.preview, desired.shape[1]))]))[by.preview :]
        return np.asarray(plant.simulate(torch.from_numpy(u)[None])[0].numpy() - plant.offset())

    def judged(by: MultiAxisInverse) -> tuple[list[float], list[list[float]], int, int]:
        error = 100 * rms(moved(by, yd) - yd) / rms(yd)
        held, limited = by.held_inputs, by.limited_outputs
        coupling = np.zeros((yd.shape[1], yd.shape[1]))
        for axis in range(yd.shape[1]):
            alone = np.zeros_like(yd)
            alone[:, axis] = yd[:, axis]
            coupling[axis] = 100 * rms(moved(by, alone)) / rms(yd)[axis]
            coupling[axis, axis] = 0
        return error.tolist(), coupling.tolist(), held, limited

    ours, theirs = judged(inverse), judged(linear)
    return AxesTracking(rms(yd).tolist(), ours[0], ours[1], theirs[0], theirs[1], ours[2], ours[3])


def random_axes(inverse: MultiAxisInverse, seconds: float, band_hz: float, seed: int = 0) -> np.ndarray:
    """Return random motions, (time, outputs), µm, up to a frequency, as large as `WITHIN` allows."""
    random, rate = np.random.default_rng(seed), inverse.stage.sample_rate_hz
    samples, outputs = int(seconds * rate), inverse.stage.outputs
    spectrum = np.zeros((samples // 2 + 1, outputs), complex)
    last = int(band_hz / rate * samples)
    spectrum[1:last] = np.exp(2j * np.pi * random.random((last - 1, outputs)))
    yd = np.fft.irfft(spectrum, samples, axis=0)
    ease = np.minimum(np.arange(samples) / (EASE_S * rate), 1.0)
    yd *= (np.sin(np.pi / 2 * ease) ** 2)[:, None] / yd.std(0)
    linear = MultiAxisInverse(inverse.stage, inverse.first, inverse.corrections, 0)
    u = linear.block(yd)
    limits = np.abs(inverse.limits_v).min(1)
    return np.asarray(yd * min(WITHIN * (limits / np.abs(u).max(0)).min(), 1e3))
