"""The play bank as an associative scan in plain torch, for accelerators.

A play clamps its previous state to [x - r, x + r]. Clamps compose to clamps, so the map from the
initial state to any later state is one clamp again, (low, high), and a doubling scan gives all of
them in log2(time) passes. It only selects among values, so the bits are those of the sequential form.
"""

from typing import Any, cast

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


def play_scan(
    x: Tensor,  # (batch, time)
    r: Tensor,  # (plays,)
    h0: Tensor,  # (batch, plays)
) -> Tensor:  # (batch, time, plays)
    """Return the states of all plays (eq. 1, 2), differentiable in all three arguments, on any device."""
    return cast(Tensor, _PlayScan.apply(x, r, h0))


class _PlayScan(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, r: Tensor, h0: Tensor) -> Tensor:
        low, high = x[..., None] - r, x[..., None] + r
        span = 1
        while span < x.shape[1]:
            # Compose each clamp with an earlier one: both ends of the earlier pass through the later.
            after_low, after_high = low[:, span:], high[:, span:]
            low, high = (
                torch.cat(
                    [ends[:, :span], torch.maximum(after_low, torch.minimum(after_high, ends[:, :-span]))], 1
                )
                for ends in (low, high)
            )
            span *= 2
        h = torch.maximum(low, torch.minimum(high, h0[:, None]))
        ctx.save_for_backward(x, r, h0, h)
        return h

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        x, r, h0, h = ctx.saved_tensors
        (gh,) = gradients
        previous = torch.cat([h0[:, None], h[:, :-1]], 1)
        low, high = previous <= x[..., None] - r, previous >= x[..., None] + r
        side = torch.where(low, -1.0, torch.where(high, 1.0, 0.0)).to(x.dtype)
        # 0 stands for the initial state, t + 1 for a push by sample t.
        numbers = torch.arange(1, x.shape[1] + 1, device=x.device)[None, :, None]
        last_push = torch.where(low | high, numbers, 0).cummax(1).values
        landed = torch.zeros_like(h0)[:, None].repeat(1, x.shape[1] + 1, 1).scatter_add_(1, last_push, gh)
        return landed[:, 1:].sum(2), (landed[:, 1:] * side).sum((0, 1)), landed[:, 0]
