"""Breakaway in the mount: after each reversal the output sticks, until the input is too far from it.

The one-parameter model of Stenman, Gustafsson and Forsman, *A segmentation-based method for detection of
stiction in control valves*, Int. J. Adaptive Control and Signal Processing 17(7–9), 2003, with a rest that
only a reversal begins, as in Choudhury, Thornhill and Shah, *Modelling valve stiction*, Control
Engineering Practice 13(5), 2005: y stays while |x - y| < J, then jumps to x - d sgn(ẋ), and follows at that
distance until the next reversal. With d = 0 it returns to x; with d = J it is a play. Driven by a voltage
that a converter holds, a mount may come to rest in every sample and move in jumps: `rests`.
"""

from collections.abc import Mapping
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor, nn

from torchpi.operators.base import StepStream
from torchpi.operators.selection import NO_SOURCE, Selection, gather, select
from torchpi.stage.effects.effect import DataRange, Effect, Needs, Parameters, parameter


def stick(x: float, breakaway: float, sliding: float, rests: bool, s: list[float]) -> float:
    """Return y(k), and update `s`: y(k-1), x(k-1), and the direction of motion, -1 or 1, or 0 if stuck."""
    if rests or s[2] * (x - s[1]) < 0.0:
        s[2] = 0.0
    s[1] = x
    if s[2] == 0.0:
        if abs(x - s[0]) < breakaway:
            return s[0]
        s[2] = 1.0 if x > s[0] else -1.0
    s[0] = x - sliding * s[2]
    return s[0]


def stick_step(x: float, n: list[float], s: list[float]) -> float:
    """`stick` as the step of a stream; n holds J, whether it rests, and d."""
    return stick(x, n[0], n[2], n[1] != 0.0, s)


class Stiction(Effect):
    """A breakaway of J, and friction d while it slides, no larger than J.

    The state is the displacement behind it, that before it, and the direction.

    The output jumps, always at a sampling instant, so its derivative in `breakaway_um` is zero almost
    everywhere. Fit it with steps that are large enough to move the jumps.
    """

    name = "stiction"
    block = "mechanics"
    equation = "y(k) = y(k-1) after a reversal while |x - y| < J, else x(k) - d sgn(ẋ)"
    signature = "flat at every reversal, then a jump back"
    time_scale = "static"
    needs = Needs(reversals=2)
    breakaway_um: nn.Parameter = parameter("µm", at_least=0.0, at_most=1e4)
    sliding_um: nn.Parameter = parameter("µm", at_least=0.0, at_most=1e4)
    rests: nn.Parameter = parameter("", at_least=0.0, at_most=1.0)
    forms = ("breakaway", "stick-slip")
    sticks = True
    jumps = ("breakaway_um",)
    kinds = ("rests",)
    state_size = 3

    @classmethod
    def form(cls, values: Mapping[str, float]) -> str:
        of = {**cls.identity, **values}
        if of["breakaway_um"] == 0:
            return ""
        return "stick-slip" if of["rests"] > 0.5 else "breakaway"

    def at_rest(self) -> bool:
        """Whether it comes to rest in every sample."""
        return self.rests.item() > 0.5

    def friction(self) -> Tensor:
        """Return d, no larger than J."""
        return torch.minimum(self.sliding_um, self.breakaway_um)

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, 3), µm, µm and -1, 0 or 1
    ) -> tuple[Tensor, Tensor]:
        before = self.initial_state(len(x)) if state is None else state
        return Selection.apply(_run, x, self.friction(), self._numbers(), before)  # type: ignore

    def stream(self) -> nn.Module:
        return StepStream(stick_step, [*self._numbers(), self.friction().item()], 3)

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        found = select(_run, x, self.friction().item(), self._numbers(), self.initial_state(1))
        return gather(dx, found.source[0].numpy())

    def _numbers(self) -> tuple[float, bool]:
        return self.breakaway_um.item(), self.at_rest()

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        shares = (0.001, 0.002, 0.004, 0.008, 0.02)
        if seen.span_um == 0:
            return []
        return [
            {
                "breakaway_um": share * seen.span_um,
                "sliding_um": part * share * seen.span_um,
                "rests": rests,
            }
            for share in shares
            for part in (0.1, 0.5)
            for rests in (0.0, 1.0)
        ]


_stick: Any = numba.njit(stick)


@numba.njit(cache=True)
def _run(
    x: np.ndarray,
    sliding: float,
    breakaway: float,
    rests: bool,
    state: np.ndarray,
    y: np.ndarray,
    source: np.ndarray,
    steps: np.ndarray,
) -> None:
    # After sliding, the output is x - d sgn(ẋ) of the last sliding sample; before, its initial value.
    for batch in range(x.shape[0]):
        last, side = NO_SOURCE, 0.0
        for t in range(x.shape[1]):
            y[batch, t] = _stick(x[batch, t], breakaway, sliding, rests, state[batch])
            if state[batch, 2] != 0.0:
                last, side = t, -state[batch, 2]
            source[batch, t], steps[batch, t] = last, side
