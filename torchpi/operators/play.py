"""The play (backlash) operator, Qin et al. (2013), eq. 1 and 2: the elementary hysteresis."""

from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor, nn

from torchpi.errors import ConfigError
from torchpi.operators.base import Operator, check_records
from torchpi.operators.compiled import HAS_COMPILER, as_array
from torchpi.operators.play_equation import play as play
from torchpi.operators.play_kernel import play_bank_backward, play_bank_forward
from torchpi.operators.play_scan import play_scan


class PlayBank(Operator):
    """A bank of plays over one input: (batch, time) to (batch, time, plays).

    Args:
        thresholds: r, in the unit of the input, each finite and not negative; r = 0 copies the input.
        trainable: Whether gradients reach the thresholds. A threshold of exactly 0 stays 0.

    Raises:
        ConfigError: No threshold, or one that is negative or not finite; when called, no tensor of records.

    Example:
        >>> import torch
        >>> from torchpi import PlayBank
        >>> x = torch.tensor([[0.0, 1.0, 2.0, 1.0, 0.0]], dtype=torch.float64)
        >>> states, last = PlayBank([0.0, 0.5])(x)
        >>> states[0, :, 1].tolist()
        [0.0, 0.5, 1.5, 1.5, 0.5]
    """

    def __init__(self, thresholds: Sequence[float], trainable: bool = False) -> None:
        super().__init__()
        self.raw_thresholds = threshold_parameter("thresholds", thresholds, trainable)

    @property
    def r(self) -> Tensor:
        """Thresholds, (plays,), in the unit of the input."""
        # relu, not clamp: its gradient at 0 is 0, so that a play that copies the input remains one.
        return torch.relu(self.raw_thresholds)

    def initial_state(self, batch: int) -> Tensor:
        return self.raw_thresholds.detach().new_zeros(batch, len(self.raw_thresholds))

    def forward(
        self,
        x: Tensor,  # (batch, time)
        state: Tensor | None = None,  # (batch, plays)
    ) -> tuple[Tensor, Tensor]:  # (batch, time, plays), (batch, plays)
        check_records(x)
        h0 = self.initial_state(len(x)) if state is None else state
        h = play_bank(x, self.r.to(x.dtype), h0.to(x.dtype))
        return h, h[:, -1]

    def stream(self) -> "PlayStream":
        return PlayStream(self.r.tolist())

    def extra_repr(self) -> str:
        r = self.r.tolist()
        return f"plays={len(r)}, thresholds {min(r):.4g} … {max(r):.4g}"


def threshold_parameter(name: str, values: Sequence[float], trainable: bool) -> nn.Parameter:
    """Return the thresholds as a parameter, (plays,).

    Raises:
        ConfigError: No threshold, or one that is negative or not finite.
    """
    expected = f"{name}: found {values}, expected at least one finite number, none negative"
    try:
        r = torch.as_tensor(values, dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError):  # words, nothing, ragged lists
        raise ConfigError(expected) from None
    if r.ndim != 1 or len(r) == 0 or not bool(torch.isfinite(r).all()) or bool((r < 0).any()):
        raise ConfigError(expected)
    return nn.Parameter(r.clone(), requires_grad=trainable)


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
    x: Tensor,  # (batch, time), any unit
    r: Tensor,  # (plays,), the unit of x
    h0: Tensor,  # (batch, plays), the unit of x
) -> Tensor:  # (batch, time, plays), the unit of x
    """Return the states of all plays over a whole record, differentiable in `x`, `r` and `h0`.

    The CPU runs a compiled sequential kernel; elsewhere or without Numba an associative scan gives the same
    bits, because both only select among x - r, x + r and h0. Where the previous state lies on the edge
    of the play or beyond, the sample pushes it and takes the gradient; r = 0 thus passes gradient 1.

    Memory: the result, which backward keeps, and nothing else of its size. If the states themselves are not
    needed, `weighted_plays` avoids storing them.

    Example:
        >>> import torch
        >>> from torchpi.operators import play_bank
        >>> x, r = torch.tensor([[0.0, 2.0, 0.0]]), torch.tensor([0.0, 0.5])
        >>> play_bank(x, r, h0=torch.zeros(1, 2))[0].tolist()
        [[0.0, 0.0], [2.0, 1.5], [0.0, 0.5]]
    """
    if x.device.type == "cpu" and HAS_COMPILER:
        differentiable = torch.is_grad_enabled() and any(part.requires_grad for part in (x, r, h0))
        # Calling a registered operation imports torch's compiler, which takes seconds; a bare pass avoids it.
        plain = not differentiable and not torch.compiler.is_compiling()
        return _states(x, r, h0) if plain else cast(Tensor, _play_bank(x, r, h0))
    return play_scan(x, r, h0)


def _states(x: Tensor, r: Tensor, h0: Tensor) -> Tensor:
    h = x.new_empty(*x.shape, len(r))
    play_bank_forward(as_array(x), as_array(r), as_array(h0), h.numpy())
    return h


_play_bank = torch.library.custom_op("torchpi::play_bank", _states, mutates_args=(), device_types="cpu")


@torch.library.custom_op("torchpi::play_bank_backward", mutates_args=(), device_types="cpu")
def _play_bank_backward(
    x: Tensor, r: Tensor, h0: Tensor, h: Tensor, gh: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    gx = x.new_empty(x.shape)
    gr, gh0 = play_bank_backward(
        as_array(x), as_array(r), as_array(h0), as_array(h), as_array(gh), gx.numpy()
    )
    return gx, torch.from_numpy(gr), torch.from_numpy(gh0)


@_play_bank.register_fake
def _(x: Tensor, r: Tensor, h0: Tensor) -> Tensor:
    return x.new_empty(*x.shape, len(r))


@_play_bank_backward.register_fake
def _(x: Tensor, r: Tensor, h0: Tensor, h: Tensor, gh: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    return x.new_empty(x.shape), r.new_empty(r.shape), h0.new_empty(h0.shape)


def _keep(ctx: Any, inputs: tuple[Tensor, ...], output: Tensor) -> None:
    ctx.save_for_backward(*inputs, output)


def _differentiate(ctx: Any, gh: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    gradients: tuple[Tensor, Tensor, Tensor] = _play_bank_backward(*ctx.saved_tensors, gh)
    return gradients


_play_bank.register_autograd(_differentiate, setup_context=_keep)
