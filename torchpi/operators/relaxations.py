"""Parallel first-order blocks: a linear block with a diagonal A, at a cost of n, not n².

x_i⁺ = a_i x_i + b_i u,    y = Σ_i c_i x_i + d u
"""

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from torchpi.operators.linear import Hold, LinearStream, observe, recursion


def relax(a: list[float], b: list[float], x: list[float], u: float) -> None:
    """Compute x_i⁺ = a_i x_i + b_i u in place. The kernel, the stream and the exports compile this."""
    for i in range(len(x)):
        x[i] = a[i] * x[i] + b[i] * u


class RelaxationsStream(LinearStream):
    """The bank, one sample at a time."""

    @torch.jit.export
    def step(self, u: float) -> float:
        y = observe(self.c, self.d, self.x, u)
        relax(self.a, self.b, self.x, u)
        return y


def relaxations(
    u: Tensor,  # (batch, time)
    a: Tensor,  # (n,)
    b: Tensor,  # (n,)
    c: Tensor,  # (n,)
    d: Tensor,  # ()
    x0: Tensor,  # (batch, n)
) -> tuple[Tensor, Tensor]:  # (batch, time), (batch, n)
    """Like `state_space`, but with `a` the diagonal of A."""
    return recursion(response, _backward, u, a, b, c, d, x0)


def relaxation(omega_t: Tensor, hold: Hold) -> tuple[Tensor, Tensor, Tensor]:
    """Return a, b and d of first-order lags, x⁺ = a x + b u, y = x + d u, which agree with ẏ = ω (u - y).

    This is `linear.discretise` in closed form.

    Args:
        omega_t: (n,), ω T > 0; infinity gives y = u.
        hold: Of the input: "end" or "first".
    """
    a, gamma0 = torch.exp(-omega_t), -torch.expm1(-omega_t)
    if hold == "end":
        return a, a * gamma0, gamma0
    return a, gamma0 * gamma0 / omega_t, 1 - gamma0 / omega_t


_relax: Any = numba.njit(relax)
_observe: Any = numba.njit(observe)


# A tile of the output stays in the cache while the poles are added to it. A single recursion waits for its
# previous sum; four in parallel, of four poles or in four rows, keep the processor busy.
TILE = 512


@numba.njit(cache=True)
def response(
    u: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    d: float,
    x: np.ndarray,
    y: np.ndarray,
    states: np.ndarray,
) -> None:
    if states.shape[1] > 0:
        for row in range(u.shape[0]):
            _keeping_states(u[row], a, b, c, d, x[row], y[row], states[row])
        return
    for first in range(0, u.shape[0], 4):
        last = min(first + 4, u.shape[0])
        for begin in range(0, u.shape[1], TILE):
            end = min(begin + TILE, u.shape[1])
            for row in range(first, last):
                _by_four_poles(begin, end, u[row], a, b, c, x[row], y[row])
            for i in range(len(a) // 4 * 4, len(a)):
                if last - first == 4:
                    _in_four_rows(first, begin, end, i, u, a[i], b[i], c[i], x, y)
                else:
                    for row in range(first, last):
                        _by_itself(begin, end, i, u[row], a[i], b[i], c[i], x[row], y[row])
            for row in range(first, last):
                sample, out = u[row], y[row]
                for t in range(begin, end):
                    out[t] = out[t] + d * sample[t]


@numba.njit(cache=True)
def _keeping_states(
    u: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    d: float,
    x: np.ndarray,
    y: np.ndarray,
    states: np.ndarray,
) -> None:
    for t in range(len(u)):
        for i in range(len(a)):
            states[t, i] = x[i]
        y[t] = _observe(c, d, x, u[t])
        _relax(a, b, x, u[t])


# Same as `observe` and `relax`, with sums in the same order, hence the same bits.
@numba.njit(cache=True)
def _by_four_poles(
    begin: int, end: int, u: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, x: np.ndarray,
    y: np.ndarray,
) -> None:  # fmt: skip
    for i in range(0, len(a) // 4 * 4, 4):
        a0, a1, a2, a3 = a[i], a[i + 1], a[i + 2], a[i + 3]
        b0, b1, b2, b3 = b[i], b[i + 1], b[i + 2], b[i + 3]
        c0, c1, c2, c3 = c[i], c[i + 1], c[i + 2], c[i + 3]
        x0, x1, x2, x3 = x[i], x[i + 1], x[i + 2], x[i + 3]
        for t in range(begin, end):
            now = u[t]
            total = c0 * x0 if i == 0 else y[t] + c0 * x0
            y[t] = ((total + c1 * x1) + c2 * x2) + c3 * x3
            x0, x1, x2, x3 = a0 * x0 + b0 * now, a1 * x1 + b1 * now, a2 * x2 + b2 * now, a3 * x3 + b3 * now
        x[i], x[i + 1], x[i + 2], x[i + 3] = x0, x1, x2, x3


@numba.njit(cache=True)
def _in_four_rows(
    first: int, begin: int, end: int, i: int, u: np.ndarray, a: float, b: float, c: float, x: np.ndarray,
    y: np.ndarray,
) -> None:  # fmt: skip
    u0, u1, u2, u3 = u[first], u[first + 1], u[first + 2], u[first + 3]
    y0, y1, y2, y3 = y[first], y[first + 1], y[first + 2], y[first + 3]
    x0, x1, x2, x3 = x[first, i], x[first + 1, i], x[first + 2, i], x[first + 3, i]
    for t in range(begin, end):
        if i == 0:
            y0[t], y1[t], y2[t], y3[t] = c * x0, c * x1, c * x2, c * x3
        else:
            y0[t], y1[t], y2[t], y3[t] = y0[t] + c * x0, y1[t] + c * x1, y2[t] + c * x2, y3[t] + c * x3
        x0, x1, x2, x3 = a * x0 + b * u0[t], a * x1 + b * u1[t], a * x2 + b * u2[t], a * x3 + b * u3[t]
    x[first, i], x[first + 1, i], x[first + 2, i], x[first + 3, i] = x0, x1, x2, x3


@numba.njit(cache=True)
def _by_itself(
    begin: int, end: int, i: int, u: np.ndarray, a: float, b: float, c: float, x: np.ndarray, y: np.ndarray
) -> None:
    state = x[i]
    for t in range(begin, end):
        y[t] = c * state if i == 0 else y[t] + c * state
        state = a * state + b * u[t]
    x[i] = state


@numba.njit(cache=True)
def _backward(
    u: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: float, states: np.ndarray, gy: np.ndarray,
    gx: np.ndarray, gu: np.ndarray, ga: np.ndarray, gb: np.ndarray, gc: np.ndarray, gd: np.ndarray,
) -> None:  # fmt: skip
    # The adjoint λ = dL/dx runs backwards, in gx: λ_i(t) = a_i λ_i(t+1) + c_i gy(t).
    for batch in range(u.shape[0]):
        adjoint = gx[batch]
        for t in range(u.shape[1] - 1, -1, -1):
            g, sample = gy[batch, t], u[batch, t]
            through = d * g
            gd[0] += g * sample
            for i in range(len(a)):
                through += b[i] * adjoint[i]
                gb[i] += adjoint[i] * sample
                if states.shape[1] > 0:
                    ga[i] += adjoint[i] * states[batch, t, i]
                    gc[i] += g * states[batch, t, i]
                adjoint[i] = a[i] * adjoint[i] + c[i] * g
            gu[batch, t] = through
