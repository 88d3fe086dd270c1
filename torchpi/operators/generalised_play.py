"""The generalised play: different envelopes and thresholds up and down, for asymmetric loops.

    h(t) = max{γ_up(x(t)) - r_up, min{γ_down(x(t)) + r_down, h(t - T)}}

Krasnosel'skii and Pokrovskii, *Systems with Hysteresis*, 1989; Brokate and Sprekels, *Hysteresis and Phase
Transitions*, 1996; Al Janaideh, Rakheja and Su, *A generalized Prandtl–Ishlinskii model for characterizing
the hysteresis and saturation nonlinearities of smart actuators*, Smart Mater. Struct. 18, 2009. If both
envelopes are the identity and the thresholds are equal, it is the play of eq. 1; if both are S, the play
behind the polynomial of eq. 6. The paper (Section II-A) names it as one that its direct approach can use.
"""

from typing import Any, cast

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from torchpi.errors import ConfigError
from torchpi.operators.base import Operator
from torchpi.operators.play import threshold_parameter
from torchpi.operators.polynomial import Polynomial, PolynomialStream


def clamp_play(low: float, high: float, h: float) -> float:
    """Return max{low, min{high, h}}: every play clamps its last state so, whatever moves its two ends."""
    return max(low, min(high, h))


class GeneralisedPlayBank(Operator):
    """A bank of generalised plays over one input: (batch, time) to (batch, time, plays).

    Args:
        thresholds_up: r_up, unit of the envelopes, each finite and not negative.
        thresholds_down: r_down, likewise, as many.
        envelope_up: c_1 … c_m of γ_up, a polynomial without constant term, rising over the range in use.
        envelope_down: c_1 … c_m of γ_down.
        scale: A typical size of the input, which scales the trained numbers to similar size.
        trainable_thresholds: Whether gradients reach the thresholds.

    Raises:
        ConfigError: Thresholds that are missing, negative, not finite, or not as many up as down; an
            envelope without coefficient.
    """

    def __init__(
        self,
        thresholds_up: list[float],
        thresholds_down: list[float],
        envelope_up: list[float],
        envelope_down: list[float],
        scale: float = 1.0,
        trainable_thresholds: bool = False,
    ) -> None:
        super().__init__()
        if len(thresholds_up) != len(thresholds_down):
            raise ConfigError(
                f"thresholds_down: found {len(thresholds_down)}, expected {len(thresholds_up)}, as many as up"
            )
        self.raw_up = threshold_parameter("thresholds_up", list(thresholds_up), trainable_thresholds)
        self.raw_down = threshold_parameter("thresholds_down", list(thresholds_down), trainable_thresholds)
        self.up = Polynomial(envelope_up, scale)
        self.down = Polynomial(envelope_down, scale)

    @property
    def r_up(self) -> Tensor:
        """Thresholds on the way up, (plays,)."""
        return torch.relu(self.raw_up)

    @property
    def r_down(self) -> Tensor:
        """Thresholds on the way down, (plays,)."""
        return torch.relu(self.raw_down)

    def widths(
        self,
        x: Tensor,  # (samples,)
    ) -> Tensor:
        """Return the distance between the two ends of the narrowest play at each `x`, (samples,).

        The operator is a play only where this is not negative: elsewhere the rising end wins, and there is no
        memory. The envelopes must rise as well.
        """
        narrowest = (self.r_up + self.r_down).min()
        up, down = self.up(x[None])[0][0], self.down(x[None])[0][0]
        return cast(Tensor, down - up + narrowest)

    def initial_state(self, batch: int) -> Tensor:
        return self.raw_up.detach().new_zeros(batch, len(self.raw_up))

    def forward(
        self,
        x: Tensor,  # (batch, time)
        state: Tensor | None = None,  # (batch, plays)
    ) -> tuple[Tensor, Tensor]:  # (batch, time, plays), (batch, plays)
        h0 = self.initial_state(len(x)) if state is None else state
        low = self.up(x)[0][..., None] - self.r_up.to(x.dtype)
        high = self.down(x)[0][..., None] + self.r_down.to(x.dtype)
        h = clamp_bank(low, high, h0.to(x.dtype))
        return h, h[:, -1]

    def stream(self) -> "GeneralisedPlayStream":
        return GeneralisedPlayStream(
            self.r_up.tolist(), self.r_down.tolist(), self.up.stream(), self.down.stream()
        )

    def extra_repr(self) -> str:
        return f"plays={len(self.raw_up)}"


class GeneralisedPlayStream(nn.Module):
    """The bank, one sample at a time: `step(x)` returns the list of its states."""

    r_up: list[float]
    r_down: list[float]
    h: list[float]

    def __init__(
        self, r_up: list[float], r_down: list[float], up: PolynomialStream, down: PolynomialStream
    ) -> None:
        super().__init__()
        self.r_up = r_up
        self.r_down = r_down
        self.up = up
        self.down = down
        self.h = [0.0] * len(r_up)

    @torch.jit.export
    def reset(self) -> None:
        for i in range(len(self.h)):
            self.h[i] = 0.0

    @torch.jit.export
    def step(self, x: float) -> list[float]:
        rising, falling = self.up.step(x), self.down.step(x)
        for i in range(len(self.h)):
            self.h[i] = clamp_play(rising - self.r_up[i], falling + self.r_down[i], self.h[i])
        return self.h


def clamp_bank(
    low: Tensor,  # (batch, time, plays)
    high: Tensor,  # (batch, time, plays)
    h0: Tensor,  # (batch, plays)
) -> Tensor:  # (batch, time, plays)
    """Return the states of plays whose two ends move as given, differentiable in all three arguments.

    The play of eq. 1 has low = x - r and high = x + r; here thresholds may differ up and down, or vary
    in time. A state on an end passes its gradient to that end, as in `play_bank`.
    """
    device = low.device
    return cast(Tensor, _ClampBank.apply(low.cpu(), high.cpu(), h0.cpu())).to(device)


class _ClampBank(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, low: Tensor, high: Tensor, h0: Tensor) -> Tensor:
        low, high, h0 = low.contiguous(), high.contiguous(), h0.contiguous()
        h = torch.empty_like(low)
        _forward(low.detach().numpy(), high.detach().numpy(), h0.detach().numpy(), h.numpy())
        ctx.save_for_backward(low, high, h0, h)
        return h

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        low, high, h0, h = (saved.detach() for saved in ctx.saved_tensors)
        glow, ghigh, gh0 = torch.zeros_like(low), torch.zeros_like(high), torch.zeros_like(h0)
        _backward(
            low.numpy(),
            high.numpy(),
            h0.numpy(),
            h.numpy(),
            gradients[0].contiguous().numpy(),
            glow.numpy(),
            ghigh.numpy(),
            gh0.numpy(),
        )
        return glow, ghigh, gh0


_clamp_play: Any = numba.njit(clamp_play)


@numba.njit(cache=True)
def _forward(low: np.ndarray, high: np.ndarray, h0: np.ndarray, h: np.ndarray) -> None:
    for batch in range(low.shape[0]):
        state = h0[batch].copy()
        for t in range(low.shape[1]):
            for i in range(low.shape[2]):
                state[i] = _clamp_play(low[batch, t, i], high[batch, t, i], state[i])
                h[batch, t, i] = state[i]


@numba.njit(cache=True)
def _backward(
    low: np.ndarray,
    high: np.ndarray,
    h0: np.ndarray,
    h: np.ndarray,
    gh: np.ndarray,
    glow: np.ndarray,
    ghigh: np.ndarray,
    gh0: np.ndarray,
) -> None:
    # As in play.py: the gradient waits while the play rests, and is added to the end that last pushed it.
    for batch in range(low.shape[0]):
        for i in range(low.shape[2]):
            carried = low.dtype.type(0)
            for t in range(low.shape[1] - 1, -1, -1):
                carried += gh[batch, t, i]
                previous = h[batch, t - 1, i] if t > 0 else h0[batch, i]
                if previous <= low[batch, t, i] or low[batch, t, i] >= high[batch, t, i]:
                    glow[batch, t, i] = carried
                    carried = low.dtype.type(0)
                elif previous >= high[batch, t, i]:
                    ghigh[batch, t, i] = carried
                    carried = low.dtype.type(0)
            gh0[batch, i] = carried
