"""The interface of a deployed compensator: one sample per call, plain floats, no tensor."""

from typing import Protocol

from torch import Tensor


class CompensatorStream(Protocol):
    """Interface of an exported compensator, which `torch.jit.script` compiles.

    `step` takes the desired displacement at t + preview, in µm, and returns the voltage at t. `block`
    takes any number of samples and leaves the same state as so many steps. `reset_at` starts from a
    measured displacement, `reset_at_voltage` from a measured voltage. `torchpi.control.step_guard` describes
    the guard of every step and what the counters count.
    """

    sample_period_s: float
    preview: int
    min_voltage_v: float
    max_voltage_v: float
    has_reference_filter: bool
    held_inputs: int
    outside_range: int
    limited_outputs: int

    def reset(self) -> None: ...
    def reset_at(self, yd: float) -> float: ...
    def reset_at_voltage(self, voltage_v: float) -> float: ...
    def step(self, yd: float) -> float: ...
    def block(
        self,
        yd: Tensor,  # (time,), µm, float64
    ) -> Tensor: ...  # (time,), V
