"""Step a stage as a rig: command in, displacement and reading out."""

import warnings
from math import isfinite
from typing import Any

import torch
from torch import nn

from torchpi.errors import StageError
from torchpi.operators.chain import ChainStream
from torchpi.operators.noise import NoiseStream


class StageStream:
    """A stage that runs one sample at a time.

    Args:
        rig: The parts of the stage.
        seed: Seed of the noise until `reset` sets another.
        compiled: Whether TorchScript compiles the step.
    """

    def __init__(self, rig: "RigStream", seed: int, compiled: bool) -> None:
        if compiled:
            with warnings.catch_warnings():
                # The compensator is deployed in TorchScript, although torch 2.13 deprecates it.
                warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
                self.rig: Any = torch.jit.script(rig)
        else:
            self.rig = rig
        self.seed = seed
        self.noise = NoiseStream(seed)
        self.sample = 0

    def reset(self, seed: int | None = None) -> None:
        """Return to the de-energised state and restart the noise, with this seed if one is given."""
        self.rig.reset()
        self.noise.reset(self.seed if seed is None else seed)
        self.sample = 0

    def step(self, u: float) -> tuple[float, float]:
        """Read y(k), then write u(k), V; return the displacement and the reading at tick k, µm.

        Raises:
            StageError: A command that is not finite. The state is unchanged.
        """
        if not isfinite(u):
            raise StageError(f"u: found {u} V at sample {self.sample}, expected a finite number")
        self.sample += 1
        y, reading = self.rig.step(u, self.noise.step())
        return y, reading


class RigStream(nn.Module):
    """What TorchScript compiles of it: everything but the drawing of the noise."""

    def __init__(
        self,
        to_displacement: ChainStream,
        sensor: ChainStream,
        noise_um: float,
        to_number: ChainStream,
    ) -> None:
        super().__init__()
        self.to_displacement = to_displacement
        self.sensor = sensor
        self.noise_um = noise_um
        self.to_number = to_number

    @torch.jit.export
    def reset(self) -> None:
        self.to_displacement.reset()
        self.sensor.reset()

    @torch.jit.export
    def step(self, u: float, noise: float) -> tuple[float, float]:
        y = self.to_displacement.step(u)
        reading = self.sensor.step(y)
        return y, self.to_number.step(reading + self.noise_um * noise)
