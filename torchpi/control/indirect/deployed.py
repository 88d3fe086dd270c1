"""A law of inversion as a compensator in a control loop: motion before it, limits after it."""

from typing import Any, Protocol

import torch
from torch import Tensor

from torchpi.control.reach import reach
from torchpi.control.step_guard import GuardedStep, StepLimits, step_limits
from torchpi.operators.motion import Motion
from torchpi.operators.reference_filter import ReferenceFilter, motion_stream


class Deployment(Protocol):
    """How a compensator is deployed."""

    sample_period_s: float
    preview: int
    min_voltage_v: float
    max_voltage_v: float

    def voltage(self, motion: Motion, /) -> tuple[Tensor, Tensor]: ...


class Deployed(GuardedStep):
    """What `CompensatorStream` promises, around any law with `step(y_d, rate, acceleration)`.

    Args:
        law: A scriptable module with `reset()` and `step(yd, rate, acceleration) -> float`.
        how: Sample period, preview and limits.
        reference_filter: Goes inside, and `step` takes y_r; None forms the rate from past samples.
    """

    def __init__(self, law: Any, how: Deployment, reference_filter: ReferenceFilter | None) -> None:
        super().__init__(_limits(how))
        self.law = law
        self.has_reference_filter = reference_filter is not None
        self.motion: Any = motion_stream(how.sample_period_s, reference_filter)
        self.sample_period_s = how.sample_period_s
        self.preview = how.preview

    @torch.jit.export
    def reset(self) -> None:
        self.reset_guard()
        self.motion.reset()
        self.law.reset()

    @torch.jit.export
    def step(self, yd: float) -> float:
        self.accept(yd)
        x, rate, acceleration = self.motion.step(self.last_input)
        u: float = self.law.step(x, rate, acceleration)
        self.emit(u)
        return self.last_voltage

    def at_rest(self, yd: float) -> float:
        self.motion.reset_at(yd)
        self.law.reset()
        u: float = self.law.step(yd, 0.0, 0.0)
        return u


def _limits(how: Deployment) -> StepLimits:
    """What it was made from is not known: the reach of the output limits decides what is accepted."""

    def law(y: Tensor) -> Tensor:
        still = torch.zeros_like(y[None])
        with torch.no_grad():
            return how.voltage(Motion(y[None], still, still))[0][0]

    voltages_v = how.min_voltage_v, how.max_voltage_v
    return step_limits(how.sample_period_s, voltages_v, reach(law, *voltages_v))
