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


# A tile of the output stays in the cache while the poles are added to it, four at a time.
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
    for batch in range(u.shape[0]):
        if states.shape[1] > 0:
            _keeping_states(u[batch], a, b, c, d, x[batch], y[batch], states[batch])
        else:
            for first in range(0, u.shape[1], TILE):
                _tile(first, min(first + TILE, u.shape[1]), u[batch], a, b, c, d, x[batch], y[batch])


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


@numba.njit(cache=True)
def _tile(
    first: int,
    stop: int,
    u: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    d: float,
    x: np.ndarray,
    y: np.ndarray,
) -> None:
    # Same as `observe` and `relax`, with sums in the same order, hence the same bits. A single recursion
    # waits for its previous sum; four in parallel keep the processor busy.
    n, i = len(a), 0
    while i + 4 <= n:
        a0, a1, a2, a3 = a[i], a[i + 1], a[i + 2], a[i + 3]
        b0, b1, b2, b3 = b[i], b[i + 1], b[i + 2], b[i + 3]
        c0, c1, c2, c3 = c[i], c[i + 1], c[i + 2], c[i + 3]
        x0, x1, x2, x3 = x[i], x[i + 1], x[i + 2], x[i + 3]
        for t in range(first, stop):
            now = u[t]
            total = c0 * x0 if i == 0 else y[t] + c0 * x0
            y[t] = ((total + c1 * x1) + c2 * x2) + c3 * x3
            x0, x1, x2, x3 = a0 * x0 + b0 * now, a1 * x1 + b1 * now, a2 * x2 + b2 * now, a3 * x3 + b3 * now
        x[i], x[i + 1], x[i + 2], x[i + 3] = x0, x1, x2, x3
        i += 4
    while i < n:
        x0 = x[i]
        for t in range(first, stop):
            y[t] = c[i] * x0 if i == 0 else y[t] + c[i] * x0
            x0 = a[i] * x0 + b[i] * u[t]
        x[i] = x0
        i += 1
    for t in range(first, stop):
        y[t] = y[t] + d * u[t]


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
