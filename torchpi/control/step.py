"""The contract of a compensator as it is deployed: one sample a call, plain floats, no tensor."""

from typing import Protocol

from torch import Tensor


class CompensatorStream(Protocol):
    """What an exported compensator offers; `torch.jit.script` compiles it.

    `step` takes the desired displacement at t + preview, in µm, and returns the voltage at t. `block`
    takes as many samples as it is given, and leaves the same state. `reset_at` starts from a
    measured displacement, `reset_at_voltage` from a measured voltage. The guard of every step, and what the
    counters count, is in `torchpi.control.step_guard`.
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
