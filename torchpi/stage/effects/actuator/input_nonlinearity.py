"""Curvature ahead of the hysteresis: w = v + c₂v² + c₃v³ (Qin et al., 2013, eq. 4, with c₁ = 1)."""

from torch import nn

from torchpi.stage.effects.curvature import Curvature
from torchpi.stage.effects.effect import parameter


class InputNonlinearity(Curvature):
    """A memoryless curvature of the voltage that the plays then see; c₁ = 1, for the plays have the gain."""

    name = "input_nonlinearity"
    block = "actuator"
    before_hysteresis = True
    equation = "w = v + c₂v² + c₃v³, then the plays"
    signature = "even (c₂) and odd (c₃) harmonics that persist as f → 0, and loops with unequal halves"
    time_scale = "static"
    degenerate_with = ("sensor_nonlinearity",)
    c2_per_v: nn.Parameter = parameter("1/V", at_least=-1e3, at_most=1e3)
    c3_per_v2: nn.Parameter = parameter("1/V²", at_least=-1e6, at_most=1e6)
