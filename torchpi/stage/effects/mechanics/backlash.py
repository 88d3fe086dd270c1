"""Lost motion in the mount: a play of half the width in series with the displacement, sharp or rounded.

y(k) = max{x(k) - w/2, min{x(k) + w/2, y(k-1)}}: Qin et al. (2013), eq. 1, with r = w/2; Nordin and
Gutman, *Controlling mechanical systems with backlash, a survey*, Automatica 38(10), 2002. The rounded form is
Dahl friction behind a spring, `torchpi.stage.effects.mechanics.presliding`.
"""

from collections.abc import Mapping
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor, nn

from torchpi.operators.base import StepStream
from torchpi.operators.play import play, play_bank
from torchpi.operators.selection import NO_SOURCE, gather
from torchpi.stage.effects.effect import DataRange, Effect, Needs, Parameters, parameter
from torchpi.stage.effects.mechanics.presliding import Slide, slide_step, slide_tangent


def play_step(x: float, n: list[float], s: list[float]) -> float:
    """`play` as the step of a stream; n holds the threshold, s the state."""
    s[0] = play(x, n[0], s[0])
    return s[0]


class Backlash(Effect):
    """A play of full width w, its corners rounded over a presliding length ρ.

    The state is the displacement behind the play and, with ρ > 0, also the displacement before it.
    """

    name = "backlash"
    block = "mechanics"
    equation = "y(k) = max{x(k) - w/2, min{x(k) + w/2, y(k-1)}}, or y = x - d, dd/dy = (w/2 - d sgn ẏ)/ρ"
    signature = "flat at every reversal, by the same amount at any amplitude"
    time_scale = "static"
    needs = Needs(reversals=2)
    forms = ("play", "Dahl")
    sticks = True
    width_um: nn.Parameter = parameter("µm", at_least=0.0, at_most=1e4)
    presliding_um: nn.Parameter = parameter("µm", at_least=0.0, at_most=1e4)

    @classmethod
    def form(cls, values: Mapping[str, float]) -> str:
        of = {**cls.identity, **values}
        if of["width_um"] == 0:
            return ""
        return "Dahl" if of["presliding_um"] > 0 else "play"

    def is_round(self) -> bool:
        """Whether the corners are rounded by presliding."""
        return self.presliding_um.item() > 0

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, 2 if self.is_round() else 1, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, 1 or 2), µm
    ) -> tuple[Tensor, Tensor]:
        h0 = (self.initial_state(len(x)) if state is None else state).to(x.dtype)
        if self.is_round():
            slid, last = Slide.apply(x, self.width_um / 2, self.presliding_um, h0)
            return slid, last
        y = play_bank(x, (self.width_um / 2).reshape(1).to(x.dtype), h0)
        return y[..., 0], y[:, -1]

    def stream(self) -> nn.Module:
        if self.is_round():
            return StepStream(slide_step, [self.width_um.item() / 2, self.presliding_um.item()], 2)
        return StepStream(play_step, [self.width_um.item() / 2], 1)

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        if self.is_round():
            return slide_tangent(x, dx, self.width_um.item() / 2, self.presliding_um.item())
        return gather(dx, _source(x[0].detach().numpy(), self.width_um.item() / 2))

    @classmethod
    def reached(cls, values: Mapping[str, float], seen: DataRange) -> bool:
        """Whether the output nearly stops at a reversal. Its slope there is 1 / (1 + w/ρ): if that exceeds a
        half, the contact is softer than half of the stage, and a smooth hysteresis looks the same."""
        return values.get("presliding_um", 0.0) <= values["width_um"]

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        shares = (0.001, 0.002, 0.004, 0.008, 0.02)
        sharp = [{"width_um": share * seen.span_um} for share in shares if seen.span_um > 0]
        return sharp + [{**start, "presliding_um": start["width_um"]} for start in sharp]


_play: Any = numba.njit(play)


@numba.njit(cache=True)
def _source(x: np.ndarray, r: float) -> np.ndarray:
    # As in the adjoint of the bank, a sample at the edge of the play or beyond pushes it.
    source = np.empty(len(x), np.int64)
    y, last = 0.0, NO_SOURCE
    for t in range(len(x)):
        if y <= x[t] - r or y >= x[t] + r:
            last = t
        source[t] = last
        y = _play(x[t], r, y)
    return source
