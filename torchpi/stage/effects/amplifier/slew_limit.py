"""A current limit into the stack's capacitance: |v̇| ≤ I_max / C_L.

At the sample instants v(k) = clip(u(k), v(k-1) ± rate T): exact for a command held during a sample. The
rate limiter of Åström and Murray, *Feedback Systems* (2008), with a follower of infinite gain.
"""

import math
from typing import Any, ClassVar

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from torchpi.operators.quantity import Quantity
from torchpi.operators.selection import NO_SOURCE, gather
from torchpi.stage.effects.effect import Effect, Parameters, Seen

EDGES = 1.5
"""Times the usual rates: what moves so much faster is an edge, and a limit between shows in it alone."""


def slew(u: float, v: float, step: float) -> float:
    """The next voltage: `u` if it is within `step` of the voltage `v` before, else as near as that."""
    return max(v - step, min(v + step, u))


class SlewLimit(Effect):
    """A voltage that follows its command no faster than a rate. The state is the voltage."""

    name = "slew_limit"
    block = "amplifier"
    before_hysteresis = True
    equation = "|v̇| ≤ I_max / C_L"
    signature = "nothing below a product of amplitude and frequency, then steep: triangles, odd harmonics"
    quantities: ClassVar[dict[str, Quantity]] = {
        "rate_v_per_s": Quantity("V/s", at_least=1e-3, at_most=1e9),
    }
    identity: ClassVar[Parameters] = {"rate_v_per_s": math.inf}
    rate_v_per_s: nn.Parameter

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, 1, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time), V
        state: Tensor | None = None,  # (batch, 1), V
    ) -> tuple[Tensor, Tensor]:
        v0 = self.initial_state(len(x)) if state is None else state
        v = _Slew.apply(x, self.sample_period_s * self.rate_v_per_s, v0.to(x.dtype))
        return v, v[:, -1:]

    def stream(self) -> nn.Module:
        return SlewStream(self.sample_period_s * self.rate_v_per_s.item())

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        step = self.sample_period_s * self.rate_v_per_s.item()
        return gather(dx, _source(x[0].detach().numpy(), step))

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        slowest = cls.quantities["rate_v_per_s"].at_least
        rates = [share * seen.max_rate_v_s for share in (0.2, 0.35, 0.5, 0.65, 0.8, 0.9)]
        if seen.peak_rate_v_s > EDGES * seen.max_rate_v_s:
            rates += [float(rate) for rate in np.geomspace(seen.max_rate_v_s, 0.9 * seen.peak_rate_v_s, 5)]
        return [{"rate_v_per_s": rate} for rate in rates if rate > slowest]


class SlewStream(nn.Module):
    """The limit, one sample at a time."""

    def __init__(self, step_v: float) -> None:
        super().__init__()
        self.step_v = step_v
        self.v = 0.0

    @torch.jit.export
    def reset(self) -> None:
        self.v = 0.0

    @torch.jit.export
    def step(self, x: float) -> float:
        self.v = slew(x, self.v, self.step_v)
        return self.v


class _Slew(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, u: Tensor, step: Tensor, v0: Tensor) -> Tensor:
        u, v0 = u.detach().contiguous(), v0.detach().contiguous()
        v = torch.empty_like(u)
        _forward(u.numpy(), step.item(), v0.numpy(), v.numpy())
        ctx.save_for_backward(u, step, v0, v)
        return v

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        u, step, v0, v = ctx.saved_tensors
        gu, gv0 = torch.empty_like(u), torch.empty_like(v0)
        arrays = (part.numpy() for part in (v0, v, gradients[0].contiguous(), gu, gv0))
        gstep = _backward(u.numpy(), step.item(), *arrays)
        return gu, torch.tensor(gstep, dtype=step.dtype), gv0


_slew: Any = numba.njit(slew)


@numba.njit(cache=True)
def _forward(u: np.ndarray, step: float, v0: np.ndarray, v: np.ndarray) -> None:
    for batch in range(u.shape[0]):
        before = v0[batch, 0]
        for t in range(u.shape[1]):
            before = _slew(u[batch, t], before, step)
            v[batch, t] = before


@numba.njit(cache=True)
def _backward(
    u: np.ndarray, step: float, v0: np.ndarray, v: np.ndarray, gv: np.ndarray, gu: np.ndarray, gv0: np.ndarray
) -> float:
    # Every voltage is the last command that was reached, plus or minus whole steps since then.
    gstep = 0.0
    for batch in range(u.shape[0]):
        carried = 0.0
        for t in range(u.shape[1] - 1, -1, -1):
            carried += gv[batch, t]
            before = v[batch, t - 1] if t > 0 else v0[batch, 0]
            if u[batch, t] > before + step:
                gstep += carried
                gu[batch, t] = 0.0
            elif u[batch, t] < before - step:
                gstep -= carried
                gu[batch, t] = 0.0
            else:
                gu[batch, t] = carried
                carried = 0.0
        gv0[batch, 0] = carried
    return gstep


@numba.njit(cache=True)
def _source(u: np.ndarray, step: float) -> np.ndarray:
    source = np.empty(len(u), np.int64)
    v, last = 0.0, NO_SOURCE
    for t in range(len(u)):
        if v - step <= u[t] <= v + step:
            last = t
        source[t] = last
        v = _slew(u[t], v, step)
    return source
