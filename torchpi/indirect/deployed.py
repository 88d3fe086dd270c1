"""A law of inversion as a compensator in a control loop: motion before it, limits after it."""

from typing import Protocol

import torch
from torch import Tensor, nn

from torchpi.motion import BackwardMotionStream
from torchpi.operators.reference_filter import ReferenceFilter


class Deployment(Protocol):
    """What a compensator says of its own deployment."""

    sample_period_s: float
    preview: int
    min_voltage_v: float
    max_voltage_v: float


class Deployed(nn.Module):
    """What `CompensatorStream` promises, around any law with `step(y_d, rate, acceleration)`.

    Args:
        law: A scriptable module with `reset()` and `step(yd, rate, acceleration) -> float`.
        how: Sample period, preview and limits.
        reference_filter: Goes inside, and `step` takes y_r; None forms the rate from past samples.
    """

    def __init__(self, law: nn.Module, how: Deployment, reference_filter: ReferenceFilter | None) -> None:
        super().__init__()
        self.law = law
        self.has_reference_filter = reference_filter is not None
        self.motion: nn.Module = (
            BackwardMotionStream(how.sample_period_s)
            if reference_filter is None
            else reference_filter.stream()
        )
        self.sample_period_s = how.sample_period_s
        self.preview = how.preview
        self.min_voltage_v = how.min_voltage_v
        self.max_voltage_v = how.max_voltage_v
        self.last_input = 0.0
        self.held_inputs = 0

    @torch.jit.export
    def reset(self) -> None:
        self.motion.reset()  # type: ignore[operator]
        self.law.reset()  # type: ignore[operator]
        self.last_input = 0.0
        self.held_inputs = 0

    @torch.jit.export
    def step(self, yd: float) -> float:
        # x - x is zero for every finite x, and not for inf and nan.
        if yd - yd == 0.0:
            self.last_input = yd
        else:
            self.held_inputs += 1
        x, rate, acceleration = self.motion.step(self.last_input)  # type: ignore[operator]
        u: float = self.law.step(x, rate, acceleration)  # type: ignore[operator]
        return min(max(u, self.min_voltage_v), self.max_voltage_v)

    @torch.jit.export
    def block(self, yd: Tensor) -> Tensor:
        u = torch.empty_like(yd)
        for i in range(len(yd)):
            # fill_, because TorchScript rounds to float32 on the way through u[i] = … or torch.tensor.
            u[i].fill_(self.step(float(yd[i])))
        return u
