"""Plays that lag behind their voltage: each relaxes towards the position of the ordinary play.

    ḣ = (1/τ) max{v - h - r, min{v - h + r, 0}}

The elementary creep operator of Krejčí and Kuhnen, *Inverse control of systems with hysteresis and creep*,
IEE Proc. Control Theory and Applications 148(3), 2001; the dynamic Preisach model of Bertotti, *Dynamic
generalization of the scalar Preisach model of hysteresis*, IEEE Trans. Magnetics 28(5), 1992, has switches
that move in this way.
For a voltage held during a sample, h(k) = p + e^{-T/τ} (h(k-1) - p), where p is the position to which the
ordinary play would move from h(k-1). τ → 0 gives the ordinary play.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torchpi.operators.compiled import as_array, njit
from torchpi.operators.generalised_play import clamp_play
from torchpi.operators.hysteresis_rows import towards


class RelaxingPlays(torch.autograd.Function):
    """The states of all plays, (batch, time, plays); a play without threshold follows at once."""

    @staticmethod
    def forward(
        ctx: Any, up: Tensor, down: Tensor, width: Tensor, kept: Tensor, h0: Tensor, r: Tensor
    ) -> Tensor:
        h = up.new_empty(*up.shape, len(r))
        _forward(
            as_array(up), as_array(down), as_array(width), kept.item(), as_array(h0), as_array(r), h.numpy()
        )
        ctx.save_for_backward(up, down, width, kept, h0, r, h)
        return h

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        up, down, width, kept, h0, r, h = ctx.saved_tensors
        by = [torch.zeros_like(part) for part in (up, down, width, h0)]
        ends = [as_array(part) for part in (up, down, width)]
        states = [as_array(part) for part in (h0, r, h, gradients[0])]
        by_kept = _backward(*ends, kept.item(), *states, *(part.numpy() for part in by))
        return by[0], by[1], by[2], torch.tensor(by_kept, dtype=kept.dtype), by[3], None


_clamp_play = njit(clamp_play)
_towards = njit(towards)


@njit
def _forward(
    up: np.ndarray,
    down: np.ndarray,
    width: np.ndarray,
    kept: float,
    h0: np.ndarray,
    r: np.ndarray,
    h: np.ndarray,
) -> None:
    for row in range(up.shape[0]):
        now = h0[row].copy()
        for t in range(up.shape[1]):
            for i in range(len(r)):
                reach = r[i] * width[row, t]
                bound = _clamp_play(up[row, t] - reach, down[row, t] + reach, now[i])
                now[i] = _towards(bound, now[i], kept if r[i] > 0.0 else 0.0)
                h[row, t, i] = now[i]


@njit
def _backward(
    up: np.ndarray, down: np.ndarray, width: np.ndarray, kept: float, h0: np.ndarray, r: np.ndarray,
    h: np.ndarray, gh: np.ndarray, gup: np.ndarray, gdown: np.ndarray, gwidth: np.ndarray, gh0: np.ndarray,
) -> float:  # fmt: skip
    by_kept = 0.0
    for row in range(up.shape[0]):
        carried = np.zeros(len(r))
        for t in range(up.shape[1] - 1, -1, -1):
            for i in range(len(r)):
                before = h[row, t - 1, i] if t > 0 else h0[row, i]
                low, high = up[row, t] - r[i] * width[row, t], down[row, t] + r[i] * width[row, t]
                left, g = kept if r[i] > 0.0 else 0.0, carried[i] + gh[row, t, i]
                if before <= low or low >= high:
                    gup[row, t] += (1.0 - left) * g
                    gwidth[row, t] -= (1.0 - left) * g * r[i]
                    carried[i] = left * g
                    by_kept += g * (before - low) if r[i] > 0.0 else 0.0
                elif before >= high:
                    gdown[row, t] += (1.0 - left) * g
                    gwidth[row, t] += (1.0 - left) * g * r[i]
                    carried[i] = left * g
                    by_kept += g * (before - high) if r[i] > 0.0 else 0.0
                else:
                    carried[i] = g
        gh0[row] = carried
    return by_kept
