"""Deployment of an inversion law in a control loop: motion before it, limits after it."""

import math
from typing import Any

import torch
from torch import Tensor, nn

from torchpi.control.reach import reach
from torchpi.control.step_guard import GuardedStep, StepLimits, step_limits
from torchpi.errors import ConfigError
from torchpi.operators.motion import Motion
from torchpi.operators.reference_filter import ReferenceFilter, motion_stream


class Inverse(nn.Module):
    """An inverse and how it is deployed; a subclass has `voltage(motion, state)` and `stream()`.

    Args:
        sample_period_s: T of the control loop.
        preview: How many samples ahead the desired trajectory is seen.
        min_voltage_v: Lower output limit; -inf for none.
        max_voltage_v: Upper output limit; inf for none.

    Raises:
        ConfigError: A value out of its range; the text names it.
    """

    def __init__(
        self, sample_period_s: float, preview: int, min_voltage_v: float, max_voltage_v: float
    ) -> None:
        super().__init__()
        if not 0 < sample_period_s < math.inf:
            raise ConfigError(f"sample_period_s: found {sample_period_s}, expected a positive number of s")
        if preview < 0:
            raise ConfigError(f"preview: found {preview}, expected a number of samples that is not negative")
        if not min_voltage_v < max_voltage_v:
            raise ConfigError(
                f"min_voltage_v: found {min_voltage_v} V, expected a number below max_voltage_v, "
                f"{max_voltage_v}"
            )
        self.sample_period_s = sample_period_s
        self.preview = preview
        self.min_voltage_v = min_voltage_v
        self.max_voltage_v = max_voltage_v

    def voltage(self, motion: Motion, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return the voltage before the output limits, (batch, time), V, and the state after it."""
        raise NotImplementedError

    def forward(self, motion: Motion) -> Tensor:
        """Return the voltage for a desired motion from the de-energised state, within the output limits.

        Shapes: (batch, time) in µm, µm/s, µm/s² to (batch, time) in V. Sample t of the motion is the one
        `preview` periods ahead of sample t of the voltage.
        """
        return self.voltage(motion)[0].clamp(self.min_voltage_v, self.max_voltage_v)


class Deployed(GuardedStep):
    """What `CompensatorStream` promises, around any law with `step(y_d, rate, acceleration)`.

    Args:
        law: A scriptable module with `reset()` and `step(yd, rate, acceleration) -> float`.
        how: The inverse, which has sample period, preview and limits.
        reference_filter: Filter inside, so that `step` takes y_r; None forms the rate from past samples.
    """

    def __init__(self, law: Any, how: Inverse, reference_filter: ReferenceFilter | None) -> None:
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


def _limits(how: Inverse) -> StepLimits:
    """Return limits by the reach of the output limits, because the training of the law is not known."""

    def law(y: Tensor) -> Tensor:
        still = torch.zeros_like(y[None])
        with torch.no_grad():
            return how.voltage(Motion(y[None], still, still))[0][0]

    voltages_v = how.min_voltage_v, how.max_voltage_v
    return step_limits(how.sample_period_s, voltages_v, reach(law, *voltages_v))
