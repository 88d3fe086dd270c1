"""Relative widening of the hysteresis loop with the rate, over whole records."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torchpi.operators.compiled import as_array, njit
from torchpi.operators.hysteresis_rows import loop_widening


class LoopWidening(torch.autograd.Function):
    """`loop_widening` sample by sample, because torch's logarithm is not bit-identical to the stream's."""

    @staticmethod
    def forward(ctx: Any, rate: Tensor, per_e: Tensor, reference: Tensor) -> Tensor:
        ctx.save_for_backward(rate, per_e, reference)
        loop = torch.empty_like(rate)
        _loop_forward(as_array(rate), per_e.item(), reference.item(), loop.numpy())
        return loop

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        rate, per_e, reference = ctx.saved_tensors
        by_size = gradients[0] * per_e / (reference + rate.abs())
        by_reference = -(by_size * rate.abs()).sum() / reference
        return by_size * rate.sign(), (gradients[0] * torch.log1p(rate.abs() / reference)).sum(), by_reference


_loop_widening = njit(loop_widening)


@njit
def _loop_forward(rate: np.ndarray, per_e: float, reference: float, loop: np.ndarray) -> None:
    for row in range(rate.shape[0]):
        for t in range(rate.shape[1]):
            loop[row, t] = _loop_widening(rate[row, t], per_e, reference)
