"""A voltage that cannot leave its range: clip(u)."""

import torch

from torchpi.operators.base import StaticStream


def clip(x: float, low: float, high: float) -> float:
    """max{low, min{high, x}}."""
    return max(low, min(high, x))


class ClipStream(StaticStream):
    """Saturation, one sample at a time."""

    def __init__(self, low: float, high: float) -> None:
        super().__init__()
        self.low = low
        self.high = high

    @torch.jit.export
    def step(self, x: float) -> float:
        return clip(x, self.low, self.high)
