"""The play (backlash) operator, Qin et al. (2013), eq. 1 and 2: the elementary hysteresis."""

from typing import Any, cast

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import FunctionCtx, once_differentiable

from torchpi.errors import ConfigError
from torchpi.operators.base import Operator
from torchpi.operators.play_scan import play_scan


def play(x: float, r: float, h: float) -> float:
    """One step of eq. 1: h(t) = max{x(t) - r, min{x(t) + r, h(t - T)}}.

    At the first sample `h` is the initial state h0, which makes it eq. 2. This one function is what
    the batch kernel, the stream and the exports compile.
    """
    return max(x - r, min(x + r, h))


class PlayBank(Operator):
    """A bank of plays over one input: (batch, time) to (batch, time, plays).

    Args:
        thresholds: r, in the unit of the input, each finite and not negative; r = 0 copies the input.
        trainable: Whether gradients reach the thresholds. A threshold of exactly 0 stays 0.

    Raises:
        ConfigError: No threshold, or one that is negative or not finite.
    """

    def __init__(self, thresholds: list[float], trainable: bool = False) -> None:
        super().__init__()
        r = torch.as_tensor(thresholds, dtype=torch.float64)
        if r.ndim != 1 or len(r) == 0 or not bool(torch.isfinite(r).all()) or bool((r < 0).any()):
            raise ConfigError(
                f"thresholds: found {list(thresholds)}, want at least one finite number, none negative"
            )
        self.raw_thresholds = nn.Parameter(r.clone(), requires_grad=trainable)

    @property
    def r(self) -> Tensor:
        """Thresholds, (plays,), in the unit of the input."""
        # relu, not clamp: its gradient at 0 is 0, so the play that copies the input stays that.
        return torch.relu(self.raw_thresholds)

    def initial_state(self, batch: int) -> Tensor:
        return self.raw_thresholds.detach().new_zeros(batch, len(self.raw_thresholds))

    def forward(
        self,
        x: Tensor,  # (batch, time)
        state: Tensor | None = None,  # (batch, plays)
    ) -> tuple[Tensor, Tensor]:  # (batch, time, plays), (batch, plays)
        h0 = self.initial_state(len(x)) if state is None else state
        h = play_bank(x, self.r.to(x.dtype), h0.to(x.dtype))
        return h, h[:, -1]

    def stream(self) -> "PlayStream":
        return PlayStream(self.r.tolist())

    def extra_repr(self) -> str:
        r = self.r.tolist()
        return f"plays={len(r)}, thresholds {min(r):.4g} … {max(r):.4g}"


class PlayStream(nn.Module):
    """The bank, one sample at a time: `step(x)` returns the list of its states."""

    r: list[float]
    h: list[float]

    def __init__(self, r: list[float]) -> None:
        super().__init__()
        self.r = r
        self.h = [0.0] * len(r)

    @torch.jit.export
    def reset(self) -> None:
        for i in range(len(self.h)):
            self.h[i] = 0.0

    @torch.jit.export
    def step(self, x: float) -> list[float]:
        for i in range(len(self.r)):
            self.h[i] = play(x, self.r[i], self.h[i])
        return self.h


def play_bank(
    x: Tensor,  # (batch, time)
    r: Tensor,  # (plays,)
    h0: Tensor,  # (batch, plays)
) -> Tensor:  # (batch, time, plays)
    """States of all plays over a whole record, differentiable in `x`, `r` and `h0`.

    On the CPU a compiled sequential kernel, elsewhere an associative scan: the same bits, because
    both only select among x - r, x + r and h0. Where the previous state lies on the edge of the
    play or beyond, the sample pushes it and takes the gradient; r = 0 thus passes gradient 1.
    """
    if x.device.type == "cpu":
        return cast(Tensor, _PlayBank.apply(x, r, h0))
    return play_scan(x, r, h0)


class _PlayBank(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, x: Tensor, r: Tensor, h0: Tensor) -> Tensor:
        x, r, h0 = x.contiguous(), r.contiguous(), h0.contiguous()
        h = torch.empty(*x.shape, len(r), dtype=x.dtype)
        _forward(x.detach().numpy(), r.detach().numpy(), h0.detach().numpy(), h.numpy())
        ctx.save_for_backward(x, r, h0, h)
        return h

    @staticmethod
    @once_differentiable
    def backward(ctx: FunctionCtx, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        x, r, h0, h = (saved.detach() for saved in ctx.saved_tensors)  # type: ignore[attr-defined]
        gx, gr, gh0 = torch.empty_like(x), torch.zeros_like(r), torch.zeros_like(h0)
        _backward(
            x.numpy(), r.numpy(), h0.numpy(), h.numpy(), gradients[0].contiguous().numpy(),
            gx.numpy(), gr.numpy(), gh0.numpy(),
        )  # fmt: skip
        return gx, gr, gh0


_play: Any = numba.njit(play)


@numba.njit(cache=True)
def _forward(x: np.ndarray, r: np.ndarray, h0: np.ndarray, h: np.ndarray) -> None:
    for batch in range(x.shape[0]):
        state = h0[batch].copy()
        for t in range(x.shape[1]):
            for i in range(len(r)):
                state[i] = _play(x[batch, t], r[i], state[i])
                h[batch, t, i] = state[i]


@numba.njit(cache=True)
def _backward(
    x: np.ndarray, r: np.ndarray, h0: np.ndarray, h: np.ndarray, gh: np.ndarray,
    gx: np.ndarray, gr: np.ndarray, gh0: np.ndarray,
) -> None:  # fmt: skip
    # Every state is x_s - r or x_s + r of the last sample s that pushed it, or h0: the gradient waits
    # in `carried` while the play rests, and lands on the sample that pushed.
    for batch in range(x.shape[0]):
        carried = np.zeros_like(r)
        for t in range(x.shape[1] - 1, -1, -1):
            pushed = carried.dtype.type(0)
            for i in range(len(r)):
                carried[i] += gh[batch, t, i]
                previous = h[batch, t - 1, i] if t > 0 else h0[batch, i]
                if previous <= x[batch, t] - r[i]:
                    pushed += carried[i]
                    gr[i] -= carried[i]
                    carried[i] = 0
                elif previous >= x[batch, t] + r[i]:
                    pushed += carried[i]
                    gr[i] += carried[i]
                    carried[i] = 0
            gx[batch, t] = pushed
        for i in range(len(r)):
            gh0[batch, i] = carried[i]
