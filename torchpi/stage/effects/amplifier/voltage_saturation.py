"""An output stage that runs into its supply: v = max{low, min{high, u}}."""

import math

import torch
from torch import Tensor, nn

from torchpi.operators.base import Static
from torchpi.operators.limits import ClipStream
from torchpi.operators.quantity import check_order
from torchpi.stage.effects.effect import DataRange, Effect, Parameters, parameter


class VoltageSaturation(Static, Effect):
    """A voltage that cannot leave its range; either limit may be missing.

    Raises:
        StageError: Limits out of order, as well.
    """

    name = "voltage_saturation"
    block = "amplifier"
    before_hysteresis = True
    equation = "v = max{low, min{high, u}}"
    signature = "nothing but beyond a level, where the tops are flat"
    time_scale = "static"
    low_v: nn.Parameter = parameter("V", at_least=-1500.0, at_most=1500.0, identity=-math.inf)
    high_v: nn.Parameter = parameter("V", at_least=-1500.0, at_most=1500.0, identity=math.inf)
    kinks = ("low_v", "high_v")

    def __init__(self, sample_period_s: float, **values: float) -> None:
        super().__init__(sample_period_s, **values)
        check_order("low_v", self.low_v.item(), "high_v", self.high_v.item(), "V")

    def of(self, x: Tensor) -> Tensor:
        return torch.clamp(x, self.low_v, self.high_v)

    def stream(self) -> nn.Module:
        return ClipStream(self.low_v.item(), self.high_v.item())

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        inside = (x >= self.low_v) & (x <= self.high_v)
        return dx.detach() * inside.to(dx.dtype)

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        if seen.span_v == 0:
            return []

        def level(share: float) -> float:
            return seen.low_v + share * seen.span_v

        above = [{"high_v": level(share)} for share in (0.995, 0.98, 0.95, 0.9, 0.8, 0.7, 0.5)]
        below = [{"low_v": level(share)} for share in (0.005, 0.02, 0.05, 0.1, 0.2, 0.3)]
        both = [{"low_v": level(share), "high_v": level(1 - share)} for share in (0.02, 0.1, 0.3)]
        return above + below + both
