"""The weighted sum of a hysteresis's plays over whole records, and its exact adjoint."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torchpi.operators.compiled import as_array, in_threads, njit
from torchpi.operators.generalised_play import clamp_play
from torchpi.operators.hysteresis_rows import piece_of

TILE = 256
"""Number of samples from one set of stored states to the next."""


class PlaySum(torch.autograd.Function):
    """The weighted sum of the plays, and their last states."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, Tensor]:
        *tensors, low_v, piece_v = inputs
        signals, (slopes, offsets, h0, r) = tensors[:7], tensors[7:]
        up = signals[1]
        y, h = torch.empty_like(up), h0.detach().clone()
        stored = up.new_empty(len(up), -(-up.shape[1] // TILE), len(r))
        arrays = [as_array(signal) for signal in signals]
        in_threads(
            _plays_forward, len(up), *arrays, as_array(slopes), as_array(offsets), as_array(r),
            low_v, piece_v, h.numpy(), stored.numpy(), y.numpy(),
        )  # fmt: skip
        ctx.pieces = low_v, piece_v
        ctx.save_for_backward(*signals, slopes, r, stored)
        return y, h

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        *signals, slopes, r, stored = ctx.saved_tensors
        by = [torch.zeros_like(signal) for signal in signals]
        by_h = gradients[1].clone(memory_format=torch.contiguous_format)
        by_slopes = slopes.new_zeros(len(by_h), *slopes.shape)
        by_offsets = torch.zeros_like(by_slopes)
        in_threads(
            _plays_backward, len(by_h), *(as_array(signal) for signal in signals), as_array(slopes),
            as_array(r), *ctx.pieces, as_array(stored), as_array(gradients[0]),
            *(part.numpy() for part in by), by_slopes.numpy(), by_offsets.numpy(), by_h.numpy(),
        )  # fmt: skip
        return *by, by_slopes.sum(0), by_offsets.sum(0), by_h, None, None, None


_clamp_play = njit(clamp_play)
_piece_of = njit(piece_of)


@njit
def _plays_forward(
    first: int, last: int, chord: np.ndarray, up: np.ndarray, down: np.ndarray, width: np.ndarray,
    gain: np.ndarray, straight: np.ndarray, loop: np.ndarray, w: np.ndarray, c: np.ndarray, r: np.ndarray,
    low_v: float, piece_v: float, h: np.ndarray, stored: np.ndarray, y: np.ndarray,
) -> None:  # fmt: skip
    part = np.empty(len(r))
    for row in range(first, last):
        now = h[row]
        for t in range(up.shape[1]):
            if t % TILE == 0:
                stored[row, t // TILE] = now
            _advance(up[row, t], down[row, t], width[row, t], r, now)
            grown, kept, looped, middle = gain[row, t], straight[row, t], loop[row, t], chord[row, t]
            for i in range(len(r)):
                x = now[i] * (grown if r[i] > 0.0 else kept)
                x = x + (x - middle) * looped
                k = _piece_of(x, low_v, piece_v, len(w))
                part[i] = c[k, i] + w[k, i] * x
            total = 0.0
            for i in range(len(r)):
                total = total + part[i]
            y[row, t] = total


@njit
def _advance(rising: float, falling: float, width: float, r: np.ndarray, h: np.ndarray) -> None:
    for i in range(len(r)):
        h[i] = _clamp_play(rising - r[i] * width, falling + r[i] * width, h[i])


@njit
def _plays_backward(
    first: int, last: int, chord: np.ndarray, up: np.ndarray, down: np.ndarray, width: np.ndarray,
    gain: np.ndarray, straight: np.ndarray, loop: np.ndarray, w: np.ndarray, r: np.ndarray, low_v: float,
    piece_v: float, stored: np.ndarray, gy: np.ndarray, gchord: np.ndarray, gup: np.ndarray,
    gdown: np.ndarray, gwidth: np.ndarray, ggain: np.ndarray, gstraight: np.ndarray, gloop: np.ndarray,
    gw: np.ndarray, gc: np.ndarray, gh: np.ndarray,
) -> None:  # fmt: skip
    # A state is an end of its play at the last sample that pushed it; back to there, gh keeps the gradient.
    tile = np.empty((TILE + 1, len(r)))
    for row in range(first, last):
        carried = gh[row]
        for index in range(stored.shape[1] - 1, -1, -1):
            begin, end = index * TILE, min(index * TILE + TILE, up.shape[1])
            tile[0] = stored[row, index]
            for t in range(begin, end):
                tile[t - begin + 1] = tile[t - begin]
                _advance(up[row, t], down[row, t], width[row, t], r, tile[t - begin + 1])
            for t in range(end - 1, begin - 1, -1):
                before, now = tile[t - begin], tile[t - begin + 1]
                looped, middle, g = loop[row, t], chord[row, t], gy[row, t]
                by_chord, by_gain, by_straight, by_loop = 0.0, 0.0, 0.0, 0.0
                by_up, by_down, by_width = 0.0, 0.0, 0.0
                for i in range(len(r)):
                    grown = gain[row, t] if r[i] > 0.0 else straight[row, t]
                    inner = now[i] * grown
                    x = inner + (inner - middle) * looped
                    k = _piece_of(x, low_v, piece_v, len(w))
                    gw[row, k, i] += g * x
                    gc[row, k, i] += g
                    by_x = g * w[k, i]
                    by_inner = by_x * (1.0 + looped)
                    by_chord -= by_x * looped
                    by_loop += by_x * (inner - middle)
                    if r[i] > 0.0:
                        by_gain += by_inner * now[i]
                    else:
                        by_straight += by_inner * now[i]
                    waiting = carried[i] + by_inner * grown
                    low, high = up[row, t] - r[i] * width[row, t], down[row, t] + r[i] * width[row, t]
                    if before[i] <= low or low >= high:
                        by_up += waiting
                        by_width -= r[i] * waiting
                        carried[i] = 0.0
                    elif before[i] >= high:
                        by_down += waiting
                        by_width += r[i] * waiting
                        carried[i] = 0.0
                    else:
                        carried[i] = waiting
                gchord[row, t], gup[row, t], gdown[row, t] = by_chord, by_up, by_down
                gwidth[row, t], ggain[row, t], gstraight[row, t] = by_width, by_gain, by_straight
                gloop[row, t] = by_loop
