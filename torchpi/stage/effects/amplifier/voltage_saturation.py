"""An output stage that runs into its supply: v = max{low, min{high, u}}, hard or soft.

Soft: the current of a transistor falls off exponentially as its voltage runs out (Ebers and Moll, *Proc. IRE*
42(12), 1954), which rounds the corner over a voltage K (`torchpi.operators.limits`).
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn

from torchpi.operators.base import Static, StepStream
from torchpi.operators.limits import clip_slope, clip_step, clipped
from torchpi.operators.quantity import check_order
from torchpi.stage.effects.effect import DataRange, Effect, Parameters, parameter

KNEES, ROUNDEST = (0.01, 0.03), 0.05
"""Shares of the voltage's span over which a corner is round: starting values of a fit, and the maximum. A
corner takes some six times that, and a curve without a straight part is a curvature of the input."""


class VoltageSaturation(Static, Effect):
    """A voltage that cannot leave its range; either limit may be missing.

    Raises:
        StageError: As for `Effect`, or if the limits are out of order.
    """

    name = "voltage_saturation"
    block = "amplifier"
    before_hysteresis = True
    equation = "v = max{low, min{high, u}}, or with corners rounded over K"
    signature = "no effect up to a level, flat peaks beyond it"
    time_scale = "static"
    forms = ("hard", "soft")
    low_v: nn.Parameter = parameter("V", at_least=-1500.0, at_most=1500.0, identity=-math.inf)
    high_v: nn.Parameter = parameter("V", at_least=-1500.0, at_most=1500.0, identity=math.inf)
    knee_v: nn.Parameter = parameter("V", at_least=0.0, at_most=1500.0)
    kinks = ("low_v", "high_v")

    def __init__(self, sample_period_s: float, **values: float) -> None:
        super().__init__(sample_period_s, **values)
        check_order("low_v", self.low_v.item(), "high_v", self.high_v.item(), "V")

    @classmethod
    def form(cls, values: Mapping[str, float]) -> str:
        of = {**cls.identity, **values}
        if math.isinf(of["low_v"]) and math.isinf(of["high_v"]):
            return ""
        return "soft" if of["knee_v"] > 0 else "hard"

    @classmethod
    def reached(cls, values: Mapping[str, float], seen: DataRange) -> bool:
        of = {**cls.identity, **values}
        inside = of["high_v"] < seen.high_v or of["low_v"] > seen.low_v
        return of["knee_v"] == 0 or (inside and of["knee_v"] <= ROUNDEST * seen.span_v)

    def of(self, x: Tensor) -> Tensor:
        return clipped(x, self.low_v, self.high_v, self.knee_v)

    def stream(self) -> nn.Module:
        return StepStream(clip_step, [self.low_v.item(), self.high_v.item(), self.knee_v.item()])

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        numbers = (self.low_v.item(), self.high_v.item(), self.knee_v.item())
        return dx.detach() * torch.from_numpy(clip_slope(x[0].detach().numpy(), *numbers))

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        if seen.span_v == 0:
            return []

        def level(share: float) -> float:
            return seen.low_v + share * seen.span_v

        above = [{"high_v": level(share)} for share in (0.995, 0.98, 0.95, 0.9, 0.8, 0.7, 0.5)]
        below = [{"low_v": level(share)} for share in (0.005, 0.02, 0.05, 0.1, 0.2, 0.3)]
        both = [{"low_v": level(share), "high_v": level(1 - share)} for share in (0.02, 0.1, 0.3)]
        hard = above + below + both
        return hard + [start | {"knee_v": knee * seen.span_v} for start in hard for knee in KNEES]
