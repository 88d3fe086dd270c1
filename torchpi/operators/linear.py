"""Linear blocks: physics in continuous time, exact at the sampling instants for any sample rate.

    ẋ = A x + B u,  y = C x + D u        →        x⁺ = A x + B u,  y = C x + D u

The matrix exponential discretises a continuous block, one compiled kernel runs it over whole records with
an exact adjoint, and a stream runs the same two equations one sample at a time.
"""

from typing import Any, Literal

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

Hold = Literal["zero", "first", "end"]
Matrices = tuple[Tensor, Tensor, Tensor, Tensor]


def advance(a: list[float], b: list[float], x: list[float], u: float, x_next: list[float]) -> None:
    """Write x⁺ = A x + B u into `x_next`; `a` is flat, row by row.

    Sums run left to right. The batch kernel, the stream and the exports compile this function and
    `observe`.
    """
    n = len(x)
    for i in range(n):
        total = a[i * n] * x[0]
        for j in range(1, n):
            total = total + a[i * n + j] * x[j]
        x_next[i] = total + b[i] * u


def observe(c: list[float], d: float, x: list[float], u: float) -> float:
    """Return y = C x + D u."""
    total = c[0] * x[0]
    for j in range(1, len(x)):
        total = total + c[j] * x[j]
    return total + d * u


def discretise(
    a: Tensor,  # (…, n, n), 1/s
    b: Tensor,  # (…, n)
    c: Tensor,  # (…, n)
    d: Tensor,  # (…)
    sample_period_s: float,
    hold: Hold,
) -> Matrices:
    """Return the discrete block that agrees with the continuous one at every sample, for the given hold.

    Args:
        a, b, c, d: The continuous block, one input and one output; leading dimensions hold several.
        sample_period_s: T.
        hold: "zero" for an input held from tick k to tick k+1, as a converter does; "end" for an input
            held during the sample that ends at tick k; "first" for an input that is linear from sample to
            sample, as a signal inside the chain nearly is.

    With "first", x(k+1) = e^{AT} x(k) + (Γ₀ - Γ₁) u(k) + Γ₁ u(k+1) (Franklin, Powell and Workman,
    *Digital Control of Dynamic Systems*, triangle hold); the state z = x - Γ₁ u brings it back to the
    standard form. A zero state then means that the input rose from 0 during the sample before the first.
    """
    n = a.shape[-1]
    # exp of [[A, B, 0], [0, 0, 1], [0, 0, 0]], time scaled to one sample: e^{AT}, Γ₀ and Γ₁ in one go.
    top = torch.cat([a * sample_period_s, b[..., None] * sample_period_s, torch.zeros_like(b)[..., None]], -1)
    ramp = torch.zeros(*a.shape[:-2], 2, n + 2, dtype=a.dtype, device=a.device)
    ramp[..., 0, n + 1] = 1.0
    exponential = torch.linalg.matrix_exp(torch.cat([top, ramp], -2))
    a_d, gamma0, gamma1 = exponential[..., :n, :n], exponential[..., :n, n], exponential[..., :n, n + 1]
    if hold == "zero":
        return a_d, gamma0, c, d
    if hold == "end":  # the state z(k) = A x(k-1), so that y(k) contains the whole response to u(k)
        return a_d, (a_d * gamma0[..., None, :]).sum(-1), c, d + (c * gamma0).sum(-1)
    b_d = gamma0 - gamma1 + (a_d * gamma1[..., None, :]).sum(-1)
    return a_d, b_d, c, d + (c * gamma1).sum(-1)


class LinearStream(nn.Module):
    """A linear block, one sample at a time."""

    a: list[float]
    b: list[float]
    c: list[float]
    x: list[float]
    x_next: list[float]

    def __init__(self, a: list[float], b: list[float], c: list[float], d: float) -> None:
        super().__init__()
        self.a = a
        self.b = b
        self.c = c
        self.d = d
        self.x = [0.0] * len(b)
        self.x_next = [0.0] * len(b)

    @torch.jit.export
    def reset(self) -> None:
        for i in range(len(self.x)):
            self.x[i] = 0.0

    @torch.jit.export
    def step(self, u: float) -> float:
        y = observe(self.c, self.d, self.x, u)
        advance(self.a, self.b, self.x, u, self.x_next)
        for i in range(len(self.x)):
            self.x[i] = self.x_next[i]
        return y


def state_space(
    u: Tensor,  # (batch, time)
    a: Tensor,  # (n, n)
    b: Tensor,  # (n,)
    c: Tensor,  # (n,)
    d: Tensor,  # ()
    x0: Tensor,  # (batch, n)
) -> tuple[Tensor, Tensor]:  # (batch, time), (batch, n)
    """Return the output and the state after the last sample; differentiable in all six arguments.

    Computed in float64 on the CPU whatever the inputs are; the output has the device and type of `u`,
    the state those of `x0`.
    """
    return recursion(response, _backward, u, a, b, c, d, x0)


def recursion(
    forward: Any, backward: Any, u: Tensor, a: Tensor, b: Tensor, c: Tensor, d: Tensor, x0: Tensor
) -> tuple[Tensor, Tensor]:
    """Run a pair of compiled kernels as one differentiable function; `a` may be a matrix or a diagonal."""
    wide = [part.to("cpu", torch.float64) for part in (u, a, b, c, d, x0)]
    if torch.is_grad_enabled():
        y, x = _Recursion.apply(forward, backward, *wide)
    else:
        y, x, _ = _run(forward, [part.contiguous() for part in wide], kept=0)
    return y.to(u.device, u.dtype), x.to(x0.device, x0.dtype)


def _run(forward: Any, wide: list[Tensor], kept: int) -> tuple[Tensor, Tensor, Tensor]:
    u, a, b, c, d, x0 = wide
    y, x, states = torch.empty_like(u), x0.clone(), u.new_empty(len(u), kept, len(b))
    forward(
        u.numpy(), a.flatten().numpy(), b.numpy(), c.numpy(), d.item(), x.numpy(), y.numpy(), states.numpy()
    )
    return y, x, states


class _Recursion(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, forward: Any, backward: Any, *wide: Tensor) -> tuple[Tensor, Tensor]:
        u, a, b, c, d, x0 = (part.detach().contiguous() for part in wide)
        learns_a, learns_c = ctx.needs_input_grad[3], ctx.needs_input_grad[5]
        # The trajectory of the state is kept only for the gradients that need it: those of A and C.
        kept = u.shape[1] if learns_a or learns_c else 0
        y, x, states = _run(forward, [u, a, b, c, d, x0], kept)
        ctx.kernel = backward
        ctx.save_for_backward(u, a, b, c, d, states)
        return y, x

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        u, a, b, c, d, states = ctx.saved_tensors
        gy, gx = gradients[0].contiguous(), gradients[1].clone(memory_format=torch.contiguous_format)
        gu, ga, gb, gc, gd = (torch.zeros_like(part) for part in (u, a, b, c, d.reshape(1)))
        ctx.kernel(
            u.numpy(), a.flatten().numpy(), b.numpy(), c.numpy(), d.item(), states.numpy(), gy.numpy(),
            gx.numpy(), gu.numpy(), ga.view(-1).numpy(), gb.numpy(), gc.numpy(), gd.numpy(),
        )  # fmt: skip
        return None, None, gu, ga, gb, gc, gd.reshape(()), gx


_advance: Any = numba.njit(advance)
_observe: Any = numba.njit(observe)


# A single row waits for its previous sum; eight rows in parallel keep the processor busy.
LANES = 8
FEWEST_FOR_LANES = 3


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
    if len(b) == 2 and states.shape[1] == 0:
        fours = u.shape[0] // 4 * 4
        for first in range(0, fours, 4):
            _four_of_second_order(first, u, a, b, c, d, x, y)
        for row in range(fours, u.shape[0]):
            _second_order(u[row], a, b, c, d, x[row], y[row])
        return
    for first in range(0, u.shape[0], LANES):
        rows = min(LANES, u.shape[0] - first)
        if rows >= FEWEST_FOR_LANES:
            _forward_lanes(first, rows, u, a, b, c, d, x, y, states)
        else:
            _forward_rows(first, rows, u, a, b, c, d, x, y, states)


@numba.njit(cache=True)
def _second_order(
    u: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: float, x: np.ndarray, y: np.ndarray
) -> None:
    # Same as `observe` and `advance` for two states, in registers; sums in the same order, hence equal bits.
    p, q = x[0], x[1]
    for t in range(len(u)):
        now = u[t]
        y[t] = (c[0] * p + c[1] * q) + d * now
        p, q = (a[0] * p + a[1] * q) + b[0] * now, (a[2] * p + a[3] * q) + b[1] * now
    x[0], x[1] = p, q


@numba.njit(cache=True)
def _four_of_second_order(
    first: int,
    u: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    d: float,
    x: np.ndarray,
    y: np.ndarray,
) -> None:
    # The same for four rows in parallel, because a single one would wait for its previous sum.
    a0, a1, a2, a3, b0, b1, c0, c1 = a[0], a[1], a[2], a[3], b[0], b[1], c[0], c[1]
    u0, u1, u2, u3 = u[first], u[first + 1], u[first + 2], u[first + 3]
    y0, y1, y2, y3 = y[first], y[first + 1], y[first + 2], y[first + 3]
    p0, p1, p2, p3 = x[first, 0], x[first + 1, 0], x[first + 2, 0], x[first + 3, 0]
    q0, q1, q2, q3 = x[first, 1], x[first + 1, 1], x[first + 2, 1], x[first + 3, 1]
    for t in range(u.shape[1]):
        now0, now1, now2, now3 = u0[t], u1[t], u2[t], u3[t]
        y0[t] = (c0 * p0 + c1 * q0) + d * now0
        y1[t] = (c0 * p1 + c1 * q1) + d * now1
        y2[t] = (c0 * p2 + c1 * q2) + d * now2
        y3[t] = (c0 * p3 + c1 * q3) + d * now3
        p0, q0 = (a0 * p0 + a1 * q0) + b0 * now0, (a2 * p0 + a3 * q0) + b1 * now0
        p1, q1 = (a0 * p1 + a1 * q1) + b0 * now1, (a2 * p1 + a3 * q1) + b1 * now1
        p2, q2 = (a0 * p2 + a1 * q2) + b0 * now2, (a2 * p2 + a3 * q2) + b1 * now2
        p3, q3 = (a0 * p3 + a1 * q3) + b0 * now3, (a2 * p3 + a3 * q3) + b1 * now3
    x[first, 0], x[first + 1, 0], x[first + 2, 0], x[first + 3, 0] = p0, p1, p2, p3
    x[first, 1], x[first + 1, 1], x[first + 2, 1], x[first + 3, 1] = q0, q1, q2, q3


@numba.njit(cache=True)
def _forward_rows(
    first: int, rows: int, u: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: float,
    x: np.ndarray, y: np.ndarray, states: np.ndarray,
) -> None:  # fmt: skip
    n = len(b)
    now, after = np.empty(n), np.empty(n)
    for batch in range(first, first + rows):
        now[:] = x[batch]
        for t in range(u.shape[1]):
            if states.shape[1] > 0:
                for i in range(n):
                    states[batch, t, i] = now[i]
            y[batch, t] = _observe(c, d, now, u[batch, t])
            _advance(a, b, now, u[batch, t], after)
            now, after = after, now
        x[batch] = now


@numba.njit(cache=True)
def _forward_lanes(
    first: int, rows: int, u: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: float,
    x: np.ndarray, y: np.ndarray, states: np.ndarray,
) -> None:  # fmt: skip
    # Same as `observe` and `advance`, with the rows innermost; sums in the same order, hence the same bits.
    n = len(b)
    now, after = np.zeros((n, LANES)), np.zeros((n, LANES))
    sample, output = np.zeros(LANES), np.zeros(LANES)
    for r in range(rows):
        now[:, r] = x[first + r]
    for t in range(u.shape[1]):
        for r in range(rows):
            sample[r] = u[first + r, t]
        if states.shape[1] > 0:
            for r in range(rows):
                for i in range(n):
                    states[first + r, t, i] = now[i, r]
        for r in range(LANES):
            output[r] = c[0] * now[0, r]
        for j in range(1, n):
            for r in range(LANES):
                output[r] = output[r] + c[j] * now[j, r]
        for r in range(rows):
            y[first + r, t] = output[r] + d * sample[r]
        for i in range(n):
            for r in range(LANES):
                after[i, r] = a[i * n] * now[0, r]
            for j in range(1, n):
                for r in range(LANES):
                    after[i, r] = after[i, r] + a[i * n + j] * now[j, r]
            for r in range(LANES):
                after[i, r] = after[i, r] + b[i] * sample[r]
        now, after = after, now
    for r in range(rows):
        x[first + r] = now[:, r]


@numba.njit(cache=True)
def _backward(
    u: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: float, states: np.ndarray, gy: np.ndarray,
    gx: np.ndarray, gu: np.ndarray, ga: np.ndarray, gb: np.ndarray, gc: np.ndarray, gd: np.ndarray,
) -> None:  # fmt: skip
    # The adjoint λ = dL/dx runs backwards: λ(t) = Aᵀ λ(t+1) + C gy(t). It starts, and ends, in gx.
    n = len(b)
    after, now = np.empty(n), np.empty(n)
    for batch in range(u.shape[0]):
        after[:] = gx[batch]
        for t in range(u.shape[1] - 1, -1, -1):
            g, sample = gy[batch, t], u[batch, t]
            through = d * g
            gd[0] += g * sample
            for j in range(n):
                now[j] = c[j] * g
            for i in range(n):
                through += b[i] * after[i]
                gb[i] += after[i] * sample
                for j in range(n):
                    now[j] += a[i * n + j] * after[i]
            if states.shape[1] > 0:
                for i in range(n):
                    gc[i] += g * states[batch, t, i]
                    for j in range(n):
                        ga[i * n + j] += after[i] * states[batch, t, j]
            gu[batch, t] = through
            now, after = after, now
        gx[batch] = after
