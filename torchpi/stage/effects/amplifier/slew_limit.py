"""A current limit into the stack's capacitance: |v̇| ≤ S = I_max / C_L, hard or soft.

Hard: at the sampling instants v(k) = clip(u(k), v(k-1) ± S T), exact for a command held during a sample; the
rate limiter of Åström and Murray, *Feedback Systems* (2008), with a follower of infinite gain.

Soft: the current of a driver saturates like that of a differential pair, in a slow feedback loop,

    v̇ = S tanh((u - v) / V),    2πf_c = S / V for small differences

(Solomon, *The monolithic op amp: a tutorial study*, IEEE J. Solid-State Circuits 9(6), 1974: slew rate and
bandwidth of one integrator). For a held command there is an exact closed form in e = u - v:

    sinh(e(k)/V) = sinh(e(k-1)/V) e^{-ST/V}
"""

import math
from collections.abc import Mapping
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from torchpi.operators.base import StepStream
from torchpi.stage.effects.effect import DataRange, Effect, Parameters, parameter

EDGES = 1.5
"""Multiple of the usual rates from which a motion is an edge; a limit in between shows only in edges."""
IN_ONE_SAMPLE, TRAVERSES = 0.1, 10
"""If the usual rates cover this share of the span in one sample, they are those of edges, and a limit may lie
anywhere below, down to the rate at which the voltage could cross its span so often in a recording."""
KNEES = (0.02, 0.2)
"""Shares of the voltage's span at which a soft limit begins to saturate, as starting values of a fit."""


def slew(u: float, v: float, step: float, knee: float) -> float:
    """Return the voltage one sample after `v`, with step = ST and V = `knee`, 0 for the hard limit."""
    if knee == 0.0:
        return max(v - step, min(v + step, u))
    # In units of V: the difference, how far it may come, and what is left, asinh(e^{-p} sinh z).
    z, p = abs(u - v) / knee, step / knee
    if z - p > 20.0:  # where sinh is an exponential, to the last bit
        left = z - p
    elif z < 1.0:
        left = math.asinh(math.exp(-p) * math.sinh(z))
    else:
        left = math.asinh(0.5 * (math.exp(z - p) - math.exp(-z - p)))
    return u - left * knee if u > v else u + left * knee


def slew_step(x: float, n: list[float], s: list[float]) -> float:
    """`slew` as the step of a stream; n holds the step and the knee, s the voltage."""
    s[0] = slew(x, s[0], n[0], n[1])
    return s[0]


class SlewLimit(Effect):
    """A voltage that follows its command no faster than a rate. The state is the voltage."""

    name = "slew_limit"
    block = "amplifier"
    before_hysteresis = True
    equation = "|v̇| ≤ S = I_max / C_L, or v̇ = S tanh((u - v) / V)"
    signature = "no effect below a product of amplitude and frequency, then steep: triangles, odd harmonics"
    time_scale = "fast"
    delays = True
    smooths = True
    forms = ("hard", "soft")
    rate_v_per_s: nn.Parameter = parameter("V/s", at_least=1e-3, at_most=1e9, identity=math.inf)
    knee_v: nn.Parameter = parameter("V", at_least=0.0, at_most=1e4)
    state_size = 1

    @classmethod
    def form(cls, values: Mapping[str, float]) -> str:
        of = {**cls.identity, **values}
        if math.isinf(of["rate_v_per_s"]):
            return ""
        return "soft" if of["knee_v"] > 0 else "hard"

    @classmethod
    def reached(cls, values: Mapping[str, float], seen: DataRange) -> bool:
        # Far below its rate, a soft limit acts as a lag with the time constant V / S.
        return values["rate_v_per_s"] <= seen.peak_rate_v_s

    def forward(
        self,
        x: Tensor,  # (batch, time), V
        state: Tensor | None = None,  # (batch, 1), V
    ) -> tuple[Tensor, Tensor]:
        v0 = self.initial_state(len(x)) if state is None else state
        v = _Slew.apply(x, self.sample_period_s * self.rate_v_per_s, self.knee_v, v0.to(x.dtype))
        return v, v[:, -1:]

    def stream(self) -> nn.Module:
        return StepStream(slew_step, [self.sample_period_s * self.rate_v_per_s.item(), self.knee_v.item()], 1)

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        step, dx = self.sample_period_s * self.rate_v_per_s.item(), dx.detach().contiguous()
        dv = torch.empty_like(dx)
        _tangent(x[0].detach().numpy(), dx.numpy(), step, self.knee_v.item(), dv.numpy())
        return dv

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        slowest = cls.quantities["rate_v_per_s"].at_least
        rates = [share * seen.max_rate_v_s for share in (0.2, 0.35, 0.5, 0.65, 0.8, 0.9)]
        if seen.peak_rate_v_s > EDGES * seen.max_rate_v_s:
            rates += np.geomspace(seen.max_rate_v_s, 0.9 * seen.peak_rate_v_s, 5).tolist()
        slow = TRAVERSES * seen.span_v / seen.duration_s
        if seen.max_rate_v_s > IN_ONE_SAMPLE * seen.span_v * seen.fs_hz and 0 < slow < rates[0]:
            rates = [*np.geomspace(slow, rates[0], 6)[:-1].tolist(), *rates]
        hard = [{"rate_v_per_s": rate} for rate in rates if rate > slowest]
        knees = [{"knee_v": share * seen.span_v} for share in KNEES if seen.span_v > 0]
        return hard + [start | knee for start in hard for knee in knees]


class _Slew(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, u: Tensor, step: Tensor, knee: Tensor, v0: Tensor) -> Tensor:
        u, v0 = u.detach().contiguous(), v0.detach().contiguous()
        v = torch.empty_like(u)
        _forward(u.numpy(), step.item(), knee.item(), v0.numpy(), v.numpy())
        ctx.save_for_backward(u, step, knee, v0, v)
        return v

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        u, step, knee, v0, v = ctx.saved_tensors
        gu, gv0 = torch.empty_like(u), torch.empty_like(v0)
        arrays = (part.numpy() for part in (v0, v, gradients[0].contiguous(), gu, gv0))
        gstep, gknee = _backward(u.numpy(), step.item(), knee.item(), *arrays)
        return gu, torch.tensor(gstep, dtype=step.dtype), torch.tensor(gknee, dtype=knee.dtype), gv0


_slew: Any = numba.njit(slew)


@numba.njit(cache=True)
def _slopes(u: float, v: float, step: float, knee: float) -> tuple[float, float, float]:
    """Return the derivatives of `slew` by v, by the step and by the knee; that by u is 1 minus the first."""
    side = 1.0 if u > v else -1.0
    if knee == 0.0:
        return (1.0, side, 0.0) if abs(u - v) > step else (0.0, 0.0, 0.0)
    z, p = abs(u - v) / knee, step / knee
    r = abs(u - _slew(u, v, step, knee)) / knee
    # cosh z e^{-p} / cosh r, all exponents at most 0; e^{-p} sinh z / cosh r = tanh r.
    by_z = (math.exp(z - p - r) + math.exp(-z - p - r)) / (1.0 + math.exp(-2.0 * r))
    return by_z, side * math.tanh(r), -side * (r - by_z * z + math.tanh(r) * p)


@numba.njit(cache=True)
def _forward(u: np.ndarray, step: float, knee: float, v0: np.ndarray, v: np.ndarray) -> None:
    for batch in range(u.shape[0]):
        before = v0[batch, 0]
        for t in range(u.shape[1]):
            before = _slew(u[batch, t], before, step, knee)
            v[batch, t] = before


@numba.njit(cache=True)
def _backward(
    u: np.ndarray,
    step: float,
    knee: float,
    v0: np.ndarray,
    v: np.ndarray,
    gv: np.ndarray,
    gu: np.ndarray,
    gv0: np.ndarray,
) -> tuple[float, float]:
    gstep, gknee = 0.0, 0.0
    for batch in range(u.shape[0]):
        carried = 0.0
        for t in range(u.shape[1] - 1, -1, -1):
            carried += gv[batch, t]
            before = v[batch, t - 1] if t > 0 else v0[batch, 0]
            by_v, by_step, by_knee = _slopes(u[batch, t], before, step, knee)
            gstep += carried * by_step
            gknee += carried * by_knee
            gu[batch, t] = carried * (1.0 - by_v)
            carried = carried * by_v
        gv0[batch, 0] = carried
    return gstep, gknee


@numba.njit(cache=True)
def _tangent(u: np.ndarray, du: np.ndarray, step: float, knee: float, dv: np.ndarray) -> None:
    by_v, v = np.empty(len(u)), 0.0
    for t in range(len(u)):
        by_v[t] = _slopes(u[t], v, step, knee)[0]
        v = _slew(u[t], v, step, knee)
    for row in range(len(du)):
        moved = 0.0
        for t in range(len(u)):
            moved = du[row, t] + by_v[t] * (moved - du[row, t])
            dv[row, t] = moved
