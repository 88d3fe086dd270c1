"""Eq. 8 in one pass: the weighted sum of plays behind a polynomial, Qin et al. (2013), eq. 4, 6–8.

    u(t) = Σ_i w_i(ẏ(t), h_i(t)) h_i(t) + u_0,   h_i = H_ri[S(x)]

with the weights of `weighted_sum` over the basis of `RateWeights`. In float64 the bits are those of the
operators applied one after the other; in float32 the kernel computes in float32 throughout.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchpi.operators.compiled import as_array
from torchpi.operators.weighted_plays_kernel import Parameters, backward, forward, saved_shapes


def weighted_plays(
    x: Tensor,  # (batch, time): input of the polynomial
    rate: Tensor,  # (batch, time): ẏ
    h0: Tensor,  # (batch, plays)
    c: Tensor,  # (degree,): c_1 first
    r: Tensor,  # (plays,)
    theta: Tensor,  # θ: (plays, functions); 1 function for no rate, 2 for a linear one, more if squashed
    knots: Tensor,  # (functions - 2, 2): slope and shift of the squashed functions, (0, 2) without any
    psi: Tensor,  # ψ: (plays, degree of the output functions - 1)
    offset: Tensor,  # (): u_0
    rate_scale: float = 1.0,
    state_scale: float = 1.0,
) -> tuple[Tensor, Tensor]:  # (batch, time), (batch, plays)
    """Return u and the states after the last sample, differentiable in all tensors. Needs CPU and Numba.

    Memory: no tensor of (batch, time, plays) is formed. Kept for backward are the inputs, S(x), and the
    states before every 32nd sample of each of some dozens of stretches, which is a 32nd of such a tensor;
    backward recomputes the states in between, a tile at a time. The working memory of a thread is
    some hundred kilobytes. A record of 10⁷ samples and 10 plays, itself 0.16 GB, thus keeps 0.1 GB, where
    its states would take 0.8 GB.

    Results and gradients have the same bits for any number of threads. At a kink the gradient is that of
    `play_bank`.
    """
    inputs = (x, rate, h0, c, r, theta, knots, psi, offset, rate_scale, state_scale)
    u, final, *_ = _weighted_plays(*inputs) if torch.compiler.is_compiling() else _Eager.apply(*inputs)
    return u, final


def _forward(
    x: Tensor, rate: Tensor, h0: Tensor, c: Tensor, r: Tensor, theta: Tensor, knots: Tensor, psi: Tensor,
    offset: Tensor, rate_scale: float, state_scale: float,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:  # fmt: skip
    u, final, folded, checkpoints = _empty(x, h0, r)
    forward(
        as_array(x),
        as_array(rate),
        as_array(h0),
        _parameters(c, r, theta, knots, psi, offset, rate_scale, state_scale),
        u.numpy(),
        final.numpy(),
        folded.numpy(),
        checkpoints.numpy(),
    )
    return u, final, folded, checkpoints


def _backward(
    x: Tensor, rate: Tensor, c: Tensor, r: Tensor, theta: Tensor, knots: Tensor, psi: Tensor, offset: Tensor,
    rate_scale: float, state_scale: float, folded: Tensor, checkpoints: Tensor, gu: Tensor, gfinal: Tensor,
    with_rate: bool, with_r: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:  # fmt: skip
    gx, gh0 = x.new_empty(x.shape), gfinal.clone()
    # Zeros, because the kernel does not write it if there is no function of the rate.
    grate = rate.new_zeros(rate.shape if with_rate else (len(rate), 0))
    sums = backward(
        as_array(x), as_array(rate), _parameters(c, r, theta, knots, psi, offset, rate_scale, state_scale),
        as_array(folded), as_array(checkpoints), as_array(gu), gh0.numpy(), with_rate, with_r,
        gx.numpy(), grate.numpy(),
    )  # fmt: skip
    return gx, grate, gh0, torch.from_numpy(sums)


def _parameters(
    c: Tensor,
    r: Tensor,
    theta: Tensor,
    knots: Tensor,
    psi: Tensor,
    offset: Tensor,
    rate_scale: float,
    state_scale: float,
) -> Parameters:
    scales = np.array([rate_scale, state_scale], as_array(c).dtype)
    return Parameters(
        as_array(c),
        as_array(r),
        as_array(theta),
        as_array(knots),
        as_array(psi),
        as_array(offset.reshape(1)),
        scales,
    )


def _empty(x: Tensor, h0: Tensor, r: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    folded, checkpoints = saved_shapes(x.shape[0], x.shape[1], len(r))
    return x.new_empty(x.shape), h0.new_empty(h0.shape), x.new_empty(folded), x.new_empty(checkpoints)


_weighted_plays = torch.library.custom_op(
    "torchpi::weighted_plays", _forward, mutates_args=(), device_types="cpu"
)
_weighted_plays_backward = torch.library.custom_op(
    "torchpi::weighted_plays_backward", _backward, mutates_args=(), device_types="cpu"
)


@_weighted_plays.register_fake
def _(
    x: Tensor, rate: Tensor, h0: Tensor, c: Tensor, r: Tensor, *others: Any
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    return _empty(x, h0, r)


@_weighted_plays_backward.register_fake
def _(x: Tensor, rate: Tensor, *others: Any) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    parameters, (gfinal, with_rate, _) = others[:6], others[-3:]
    grate = rate if with_rate else rate[:, :0]
    sums = x.new_empty(sum(part.numel() for part in parameters))
    return x.new_empty(x.shape), grate.new_empty(grate.shape), gfinal.new_empty(gfinal.shape), sums


def _keep(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    x, rate, _, *parameters, rate_scale, state_scale = inputs
    ctx.scales = rate_scale, state_scale
    ctx.save_for_backward(x, rate, *parameters, *output[2:])


def _differentiate(ctx: Any, gu: Tensor, gfinal: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:
    return _gradients(ctx, _weighted_plays_backward, gu, gfinal)


def _gradients(
    ctx: Any, backward_of: Callable[..., tuple[Tensor, Tensor, Tensor, Tensor]], gu: Tensor, gfinal: Tensor
) -> tuple[Tensor | None, ...]:
    x, rate, *parameters, folded, checkpoints = ctx.saved_tensors
    # By position among the arguments of the operation: ẏ and the knots, if there are any, and r.
    with_knots = ctx.needs_input_grad[6] and parameters[3].numel() > 0
    with_rate, with_r = ctx.needs_input_grad[1] or with_knots, ctx.needs_input_grad[4]
    gx, grate, gh0, sums = backward_of(
        x, rate, *parameters, *ctx.scales, folded, checkpoints, gu, gfinal, with_rate, with_r
    )
    parts = zip(
        sums.split([part.numel() for part in parameters]), parameters, ctx.needs_input_grad[3:9], strict=True
    )
    gradients = (part.view(like.shape) if needed else None for part, like, needed in parts)
    return gx, grate if with_rate else None, gh0, *gradients, None, None


_weighted_plays.register_autograd(_differentiate, setup_context=_keep)


class _Eager(torch.autograd.Function):
    """The same operation without the dispatcher, which takes a fifth of a pass over some thousand samples."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, Tensor]:
        output = _forward(*inputs)
        _keep(ctx, inputs, output)
        return output[:2]

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gu: Tensor, gfinal: Tensor) -> tuple[Tensor | None, ...]:
        return _gradients(ctx, _backward, gu, gfinal)
