"""A converter of finite resolution: the nearest of 2^bits levels that divide its range."""

import math
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.autograd.function import FunctionCtx, once_differentiable

from torchpi.errors import StageError
from torchpi.operators.base import Operator
from torchpi.operators.limits import clip
from torchpi.operators.quantity import Quantity


def quantize(x: float, low: float, step: float, last_code: float) -> float:
    """low + step · code, the code being the nearest of 0 … last_code; halves round up."""
    return low + step * clip(float(math.floor((x - low) / step + 0.5)), 0.0, last_code)


class Quantization(Operator):
    """A converter. Its gradient is straight-through: 1 inside the range, 0 beyond, as if it had no steps.

    Args:
        bits: Resolution.
        low: Value of code 0, unit of the input.
        high: Upper end of the range; the last code is one step below it.

    Raises:
        StageError: Fewer than 1 or more than 32 bits, or a range out of order.
    """

    quantities: ClassVar[dict[str, Quantity]] = {"bits": Quantity("bits", at_least=1, at_most=32)}

    def __init__(self, bits: int, low: float, high: float) -> None:
        super().__init__()
        self.bits = int(self.quantities["bits"].check("bits", bits))
        if not -math.inf < low < high < math.inf:
            raise StageError(f"high: found {high:g}, want a finite number above low = {low:g}")
        self.low = float(low)
        self.high = float(high)
        self.last_code = 2.0**self.bits - 1.0
        self.step_size = (self.high - self.low) / 2.0**self.bits

    def forward(self, x: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        y = _Quantize.apply(x, self.low, self.step_size, self.last_code)
        return y, self.initial_state(len(x)) if state is None else state

    def stream(self) -> nn.Module:
        return QuantizationStream(self.low, self.step_size, self.last_code)

    def extra_repr(self) -> str:
        return f"{self.bits} bits over {self.low:g} … {self.high:g}"


class QuantizationStream(nn.Module):
    """A converter, one sample at a time."""

    def __init__(self, low: float, step_size: float, last_code: float) -> None:
        super().__init__()
        self.low = low
        self.step_size = step_size
        self.last_code = last_code

    @torch.jit.export
    def reset(self) -> None:
        return

    @torch.jit.export
    def step(self, x: float) -> float:
        return quantize(x, self.low, self.step_size, self.last_code)


class _Quantize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, x: Tensor, low: float, step: float, last_code: float) -> Tensor:
        code = torch.floor((x - low) / step + 0.5)
        ctx.save_for_backward((code >= 0) & (code <= last_code))
        return low + step * code.clamp(0.0, last_code)

    @staticmethod
    @once_differentiable
    def backward(ctx: FunctionCtx, *gradients: Tensor) -> tuple[Tensor, None, None, None]:
        (inside,) = ctx.saved_tensors  # type: ignore[attr-defined]
        return gradients[0] * inside, None, None, None
