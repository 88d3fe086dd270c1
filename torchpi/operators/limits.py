"""A voltage that cannot leave its range: clip(u)."""

import torch
from torch import Tensor, nn

from torchpi.errors import StageError
from torchpi.operators.base import Operator


def clip(x: float, low: float, high: float) -> float:
    """max{low, min{high, x}}."""
    return max(low, min(high, x))


class Clip(Operator):
    """Saturation; the gradient is 1 inside the limits, 0 beyond.

    Args:
        low: Lower limit, unit of the input; -inf for none.
        high: Upper limit; inf for none.

    Raises:
        StageError: Limits out of order.
    """

    def __init__(self, low: float, high: float) -> None:
        super().__init__()
        if not low < high:
            raise StageError(f"high: found {high:g}, want more than low = {low:g}")
        self.low = float(low)
        self.high = float(high)

    def forward(self, x: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        return x.clamp(self.low, self.high), self.initial_state(len(x)) if state is None else state

    def stream(self) -> nn.Module:
        return ClipStream(self.low, self.high)

    def extra_repr(self) -> str:
        return f"{self.low:g} … {self.high:g}"


class ClipStream(nn.Module):
    """Saturation, one sample at a time."""

    def __init__(self, low: float, high: float) -> None:
        super().__init__()
        self.low = low
        self.high = high

    @torch.jit.export
    def reset(self) -> None:
        return

    @torch.jit.export
    def step(self, x: float) -> float:
        return clip(x, self.low, self.high)
