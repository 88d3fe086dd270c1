"""Single wrong readings: a lost sample that is read as 0, as the last value, or as any other value.

They are additive outliers (Fox, *Outliers in time series*, J. Royal Statistical Society B 34(3), 1972), found
in the readings by `torchpi.recordings.faults.dropouts`.
"""

from torch import Tensor, nn

from torchpi.operators.base import Static
from torchpi.operators.chain import ChainStream
from torchpi.stage.effects.effect import DataRange, Effect, Parameters, parameter


class Dropouts(Static, Effect):
    """Readings that are not of the stage. Nothing predicts them: the output is the input, whatever the share.

    `share` is the fraction of wrong readings, for the report.
    """

    name = "dropouts"
    block = "sensor"
    equation = "y(k) = anything at a few k, else x(k)"
    signature = "single readings far from both of their neighbours"
    read_off = True
    unseen = "no single reading lies far off its neighbours"
    share: nn.Parameter = parameter("", at_least=0.0, at_most=1.0)
    per_recording = ("share",)

    def of(self, x: Tensor) -> Tensor:
        return x

    def stream(self) -> nn.Module:
        return ChainStream([])

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        return dx

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        return []
