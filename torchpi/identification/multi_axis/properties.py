"""Properties of a stage of several axes: loops of its actuators, modes, coupling."""

from dataclasses import dataclass

import numpy as np
import torch

from torchpi.stage.multi_axis import MultiAxisStage

LOOP_S, CYCLES = 1.0, 2
"""Period of the sine that draws loops, and number of its periods, of which the last counts."""
SHARPEST = 0.3
"""Largest damping ratio of a mode; broader ones represent dynamics beyond the band."""


@dataclass(frozen=True, eq=False)
class Loop:
    """One actuator's slow loop, at the output that it moves most.

    Attributes:
        input: Number of the input, from 1.
        output: Number of the output, from 1.
        u: (time,), V.
        y: (time,), µm, centred about its middle.
    """

    input: int
    output: int
    u: np.ndarray
    y: np.ndarray

    @property
    def width(self) -> float:
        """Width of the loop at the middle of the voltage, as a share of its stroke."""
        middle = np.abs(self.u) < 0.05 * np.abs(self.u).max()
        rises = np.gradient(self.u) > 0
        apart = self.y[middle & ~rises].mean() - self.y[middle & rises].mean()
        return float(abs(apart) / np.ptp(self.y))


def loop_of(stage: MultiAxisStage, number: int, amplitude_v: float) -> Loop:
    """Simulate the loop of an input, counted from 1, under a slow sine, with the others at rest."""
    samples = int(LOOP_S * stage.sample_rate_hz)
    u = np.zeros((CYCLES * samples, stage.inputs))
    u[:, number - 1] = amplitude_v * np.sin(2 * np.pi * np.arange(len(u)) / samples)
    y = stage.simulate(torch.from_numpy(u)[None])[0, -samples:].numpy()
    output = int(np.ptp(y, axis=0).argmax())
    drawn = y[:, output] - (y[:, output].max() + y[:, output].min()) / 2
    return Loop(number, output + 1, u[-samples:, number - 1], drawn)


def modes_of_stage(stage: MultiAxisStage) -> list[tuple[float, float]]:
    """Return frequency, Hz, and damping ratio of each mode without its feedback, the lowest first."""
    poles = stage.arrays()["poles"] @ np.array([1, 1j])
    rates = np.log(poles)
    damping = -rates.real / np.abs(rates)
    hertz = np.abs(rates) * stage.sample_rate_hz / (2 * np.pi)
    return sorted((float(f), float(d)) for f, d in zip(hertz, damping, strict=True) if d < SHARPEST)


def static_gain_of(stage: MultiAxisStage, amplitude_v: float) -> np.ndarray:
    """Return the static gain, (outputs, inputs), µm/V, of each input alone, held until the modes settle."""
    samples = int(LOOP_S * stage.sample_rate_hz)
    u = np.zeros((2 * stage.inputs, samples, stage.inputs))
    for i in range(stage.inputs):
        u[2 * i, :, i], u[2 * i + 1, :, i] = amplitude_v, -amplitude_v
    y = stage.simulate(torch.from_numpy(u))[:, -samples // 4 : -stage.delay_samples].mean(1).numpy()
    return np.asarray((y[::2] - y[1::2]).T / (2 * amplitude_v))
