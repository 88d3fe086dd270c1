"""A small stage of two axes, and recordings of it."""

import numpy as np
import torch

from torchpi.operators.modal_feedback import Shapes, parameter_shapes
from torchpi.recordings.multi_axis import MultiAxisRecording
from torchpi.stage.multi_axis import MultiAxisStage

RATE_HZ = 1000.0


def two_axes(force: float = 0.02) -> MultiAxisStage:
    """Return a stage of two coupled modes at 60 and 110 Hz with a nonlinear element at each."""
    shapes = Shapes(2, 2, 2, 2, 1 + 2 + 1 + 1, 2, ahead=3)
    arrays = {name: np.zeros(shape) for name, shape in parameter_shapes(shapes).items()}
    for m, (frequency, damping) in enumerate(((60.0, 0.03), (110.0, 0.02))):
        pole = np.exp(2 * np.pi * frequency / RATE_HZ * (-damping + 1j))
        arrays["poles"][m] = pole.real, pole.imag
    arrays["drive"][:, 1] = arrays["force"][:, 1] = [[0.3, 0.1], [-0.1, 0.4]]
    arrays["seen"][:, :, 0] = arrays["sensed"][:, :, 0] = [[1.0, -0.2], [0.3, 1.0]]
    arrays["direct"][:] = [[0.1, 0.0], [0.0, 0.1]]
    arrays["weights"][:] = force * np.array([1.0, 1.0, 1.0, 0.5, 0.5])
    arrays["play_weights"][:] = 0.1
    arrays["ahead"][:] = [0.05, -0.02, 0.01]
    return MultiAxisStage(RATE_HZ, arrays, [0.1, 0.3], [5.0, 20.0], [0.0], [0.1, 0.5], [5.0, 20.0], [0.05])


def multisine(random: np.random.Generator, samples: int, rms: float) -> np.ndarray:
    """Return all lines up to 0.7 of the Nyquist frequency with random phases, (samples, 2)."""
    spectrum = np.zeros((samples // 2 + 1, 2), complex)
    last = int(0.7 * samples / 2)
    spectrum[1:last] = np.exp(2j * np.pi * random.random((last - 1, 2)))
    u = np.fft.irfft(spectrum, axis=0)
    return rms * u / u.std(0)


def recordings(stage: MultiAxisStage, levels: tuple[float, ...], runs: int) -> list[MultiAxisRecording]:
    """Return runs of two steady-state periods at each level, with noise."""
    random, found = np.random.default_rng(3), []
    for level in levels:
        for run in range(runs):
            u = np.tile(multisine(random, 512, level), (4, 1))
            y = stage.simulate(torch.from_numpy(u)[None])[0].numpy()
            y += 1e-3 * level * random.standard_normal(y.shape)
            # The run-in of the filters at both ends is cut off.
            found.append(
                MultiAxisRecording(f"{level:g} {run + 1}", u[1024 - 256 : -256], y[768:-256], RATE_HZ, 2)
            )
    return found
