"""A trajectory with its rate and acceleration, and their causal forms from samples alone."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from torchpi.errors import ConfigError, kind_of
from torchpi.operators.base import check_records


class Motion(NamedTuple):
    """A reference trajectory with its rate and acceleration.

    Attributes:
        yd: (batch, time), µm.
        yd_dot: (batch, time), µm/s.
        yd_ddot: (batch, time), µm/s².

    Example:
        >>> import torch
        >>> from torchpi import ReferenceFilter
        >>> motion = ReferenceFilter(sample_period_s=1e-4)(torch.ones(1, 200, dtype=torch.float64))
        >>> round(motion.yd_dot.max().item())  # µm/s, of a filtered step of 1 µm
        231
    """

    yd: Tensor
    yd_dot: Tensor
    yd_ddot: Tensor


def check_motion(motion: object) -> None:
    """Check that an argument is a motion of tensors.

    Raises:
        ConfigError: It is not.
    """
    if not isinstance(motion, Motion):
        raise ConfigError(
            f"motion: found {kind_of(motion)}, expected a Motion, as a ReferenceFilter gives it"
        )
    for name, part in zip(motion._fields, motion, strict=True):
        check_records(part, name)


def backward_motion(
    yd: Tensor,  # (batch, time), µm
    sample_period_s: float,
) -> Motion:
    """Form rate and acceleration from past samples only, as a compensator does that receives samples.

    The differences are of second order, so the rate does not lag by half a sample as a plain backward
    difference does. Before the first sample the trajectory is taken to have rested there.
    """
    # The three samples before each one; the repeated first sample represents standstill before it.
    held = torch.cat([yd[:, :1].expand(-1, 3), yd], 1)
    y1, y2, y3 = held[:, 2:-1], held[:, 1:-2], held[:, :-3]
    return Motion(
        yd,
        backward_rate(yd, y1, y2, sample_period_s),  # type: ignore[arg-type]
        backward_acceleration(yd, y1, y2, y3, sample_period_s),  # type: ignore[arg-type]
    )


def backward_rate(y0: float, y1: float, y2: float, sample_period_s: float) -> float:
    """Three-point backward difference, (3 y0 - 4 y1 + y2) / 2T; `y1` is one sample before `y0`.

    It is written in differences, which are exactly zero at rest. Also for tensors.
    """
    return (3.0 * (y0 - y1) - (y1 - y2)) / (2.0 * sample_period_s)


def backward_acceleration(y0: float, y1: float, y2: float, y3: float, sample_period_s: float) -> float:
    """Four-point backward second difference, (2 y0 - 5 y1 + 4 y2 - y3) / T². Also for tensors."""
    return (2.0 * (y0 - y1) - 3.0 * (y1 - y2) + (y2 - y3)) / (sample_period_s * sample_period_s)


class BackwardMotionStream(nn.Module):
    """The causal motion, one sample at a time: `step(yd)` returns (yd, rate, acceleration)."""

    def __init__(self, sample_period_s: float) -> None:
        super().__init__()
        self.sample_period_s = sample_period_s  # s
        self.started = False
        self.y1 = 0.0
        self.y2 = 0.0
        self.y3 = 0.0

    @torch.jit.export
    def reset(self) -> None:
        self.started = False

    @torch.jit.export
    def reset_at(self, yd: float) -> None:
        """Start from a trajectory that has rested at `yd`."""
        self.started = True
        self.y1 = yd
        self.y2 = yd
        self.y3 = yd

    @torch.jit.export
    def step(self, yd: float) -> tuple[float, float, float]:
        if not self.started:
            self.reset_at(yd)
        rate = backward_rate(yd, self.y1, self.y2, self.sample_period_s)
        acceleration = backward_acceleration(yd, self.y1, self.y2, self.y3, self.sample_period_s)
        self.y3 = self.y2
        self.y2 = self.y1
        self.y1 = yd
        return yd, rate, acceleration
