"""Hysteresis states that are updated by every move of the voltage, over whole records: Bouc–Wen, Duhem."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torchpi.operators.compiled import as_array, njit
from torchpi.operators.hysteresis_rows import bouc_wen, duhem, duhem_pieces


class CarriedState(torch.autograd.Function):
    """A Bouc–Wen or Duhem state, which is updated by every move of v."""

    @staticmethod
    def forward(
        ctx: Any, v: Tensor, before: Tensor, z0: Tensor, kernels: Any, numbers: tuple[float, ...]
    ) -> Tensor:
        z = torch.empty_like(v)
        forward, ctx.kernel = kernels
        ctx.numbers = numbers
        forward(as_array(v), as_array(before), as_array(z0), *numbers, z.numpy())
        ctx.save_for_backward(v, before, z0, z)
        return z

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        v, before, z0, z = ctx.saved_tensors
        by_v, by_before, by_z0 = torch.zeros_like(v), torch.zeros_like(before), torch.zeros_like(z0)
        ctx.kernel(
            *(as_array(part) for part in (v, before, z0)),
            *ctx.numbers,
            as_array(z),
            as_array(gradients[0]),
            by_v.numpy(),
            by_before.numpy(),
            by_z0.numpy(),
        )
        return by_v, by_before, by_z0, None, None


_bouc_wen = njit(bouc_wen)
_duhem = njit(duhem)


@njit
def _bouc_wen_forward(
    v: np.ndarray, before: np.ndarray, z0: np.ndarray, sigma: float, beta: float, n: float, z: np.ndarray
) -> None:
    for row in range(v.shape[0]):
        state, last = z0[row], before[row]
        for t in range(v.shape[1]):
            state = _bouc_wen(state, v[row, t] - last, sigma, beta, n)
            z[row, t] = state
            last = v[row, t]


@njit
def _duhem_forward(
    v: np.ndarray, before: np.ndarray, z0: np.ndarray, alpha: float, power: float, _: float, z: np.ndarray
) -> None:
    for row in range(v.shape[0]):
        state, last = z0[row], before[row]
        for t in range(v.shape[1]):
            state = _duhem(state, v[row, t], last, alpha, int(power))
            z[row, t] = state
            last = v[row, t]


@njit
def _bouc_wen_backward(
    v: np.ndarray, before: np.ndarray, z0: np.ndarray, sigma: float, beta: float, n: float, z: np.ndarray,
    gz: np.ndarray, gv: np.ndarray, gbefore: np.ndarray, gz0: np.ndarray,
) -> None:  # fmt: skip
    for row in range(v.shape[0]):
        carried = 0.0
        for t in range(v.shape[1] - 1, -1, -1):
            carried += gz[row, t]
            last = v[row, t - 1] if t > 0 else before[row]
            by_z, by_move = _bouc_wen_slopes(
                z[row, t - 1] if t > 0 else z0[row], v[row, t] - last, sigma, beta, n
            )
            gv[row, t] += carried * by_move
            if t > 0:
                gv[row, t - 1] -= carried * by_move
            else:
                gbefore[row] -= carried * by_move
            carried = carried * by_z
        gz0[row] = carried


@njit
def _bouc_wen_slopes(z: float, dv: float, sigma: float, beta: float, n: float) -> tuple[float, float]:
    """Return the derivatives of the state after a move by the state before it and by the move: `bouc_wen`,
    differentiated line by line."""
    pieces = int(abs(dv) / sigma * 20.0) + 1
    move = dv / pieces
    by_z, by_move = 1.0, 0.0
    for _ in range(pieces):
        at, at_by_z, at_by_move = z, by_z, by_move
        for part in (0.5, 1.0):
            sign = 1.0 if at * move >= 0.0 else -1.0
            outward = 1.0 - beta + beta * sign
            slope = 1.0 - abs(at) ** n * outward
            steepness = -n * abs(at) ** (n - 1.0) * np.sign(at) * outward if at != 0.0 else 0.0
            step = part * move / sigma
            at_by_move = by_move + part / (pieces * sigma) * slope + step * steepness * at_by_move
            at_by_z = by_z + step * steepness * at_by_z
            at = z + step * slope
        z, by_z, by_move = at, at_by_z, at_by_move
    return by_z, by_move


@njit
def _duhem_backward(
    v: np.ndarray, before: np.ndarray, z0: np.ndarray, alpha: float, power: float, _: float, z: np.ndarray,
    gz: np.ndarray, gv: np.ndarray, gbefore: np.ndarray, gz0: np.ndarray,
) -> None:  # fmt: skip
    for row in range(v.shape[0]):
        carried = 0.0
        for t in range(v.shape[1] - 1, -1, -1):
            carried += gz[row, t]
            last = v[row, t - 1] if t > 0 else before[row]
            by_z, by_v, by_last = _duhem_slopes(
                z[row, t - 1] if t > 0 else z0[row], v[row, t], last, alpha, power
            )
            gv[row, t] += carried * by_v
            if t > 0:
                gv[row, t - 1] += carried * by_last
            else:
                gbefore[row] += carried * by_last
            carried = carried * by_z
        gz0[row] = carried


@njit
def _duhem_slopes(
    z: float, v: float, before: float, alpha: float, power: float
) -> tuple[float, float, float]:
    """Return the derivatives of the state after a move by the state before it and by the move's end and
    beginning: `duhem`, differentiated line by line."""
    whole = alpha * abs(v - before)
    if whole < 1e-30:
        return 1.0, 0.0, 0.0
    pieces, gap, kept, first, second = duhem_pieces(v, before, whole)
    move, part, part_by_v = (v - before) / pieces, whole / pieces, alpha * np.sign(v - before) / pieces
    second_by_part = (((first + second) / part - kept) / part - 0.5 * (1.0 - gap) * kept) / gap
    first_by_part = kept - second_by_part
    by_z, by_v, by_before = 1.0, 0.0, 0.0
    for piece in range(pieces):
        at_early, at_late = (piece + 0.5 * (1.0 - gap)) / pieces, (piece + 0.5 * (1.0 + gap)) / pieces
        early, late = before + move * pieces * at_early, before + move * pieces * at_late
        f_early, f_late = early**power, late**power
        slope_early = first * power * early ** (power - 1.0)
        slope_late = second * power * late ** (power - 1.0)
        by_part = -kept * z + first_by_part * f_early + second_by_part * f_late
        by_end = slope_early * at_early + slope_late * at_late
        by_v = kept * by_v + by_part * part_by_v + by_end
        by_before = kept * by_before - by_part * part_by_v + slope_early + slope_late - by_end
        by_z = kept * by_z
        z = kept * z + first * f_early + second * f_late
    return by_z, by_v, by_before


BOUC_WEN = (_bouc_wen_forward, _bouc_wen_backward)
DUHEM = (_duhem_forward, _duhem_backward)
