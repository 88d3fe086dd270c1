"""The law that all indirect inverses share, compiled once for records and once for control loops.

    x = S⁻¹(y_d + τ_1 ẏ_d + τ_2 ÿ_d)          undoes linear dynamics and saturation, if the model has them
    r_i(ẏ_d) = r_i + ρ_i |ẏ_d|,  w_i(ẏ_d) = b_i + k_i ẏ_d       of the forward model, at this sample
    u = Σ_i w'_i H_r'i[x]                     r', w' from r, w by the closed form of `inversion_law`

Each method uses some of ρ, k and τ; its file explains where they come from and when the inverse is exact.
"""

import math
from collections.abc import Sequence
from typing import Any, cast

import numba
import numpy as np
import torch
from numba.extending import register_jitable
from torch import Tensor, nn

from torchpi.control.indirect.deployed import Deployed, Inverse
from torchpi.control.indirect.inversion_law import check_invertible, inverse_numbers, invert
from torchpi.control.step import CompensatorStream
from torchpi.errors import ConfigError
from torchpi.operators.dead_zone import DeadZones, dead_zone, dead_zones
from torchpi.operators.motion import Motion
from torchpi.operators.play import play
from torchpi.operators.reference_filter import ReferenceFilter

LEAST_SLOPE = 0.05  # of the slope at rest: the rate is limited so that no slope of the model falls below it


class IndirectInverse(Inverse):
    """A forward Prandtl–Ishlinskii model, inverted; see the subclasses. Nothing in it is trained.

    Args:
        sample_period_s: T of the control loop.
        thresholds: r of the forward model at rest, V, rising from 0.
        weights: b of the forward model at rest, µm/V.
        threshold_slopes: ρ, V per µm/s; none for constant thresholds.
        weight_slopes: k, µm/V per µm/s; none for constant weights.
        lead: At most τ_1 in s and τ_2 in s²; none for no dynamics.
        saturation: The forward model's dead zones, displacement of the plays to displacement; None for none.
        preview: How many samples ahead the desired trajectory is seen.
        min_voltage_v: Lower output limit; -inf for none.
        max_voltage_v: Upper output limit; inf for none.

    Raises:
        ConfigError: A forward model that has no inverse, or a value out of its range; the text names it.
    """

    def __init__(
        self,
        sample_period_s: float,
        thresholds: Sequence[float],
        weights: Sequence[float],
        *,
        threshold_slopes: Sequence[float] = (),
        weight_slopes: Sequence[float] = (),
        lead: Sequence[float] = (),
        saturation: DeadZones | None = None,
        preview: int = 0,
        min_voltage_v: float = 0.0,
        max_voltage_v: float = 10.0,
    ) -> None:
        super().__init__(sample_period_s, preview, min_voltage_v, max_voltage_v)
        check_invertible(thresholds, weights)
        self.r = _numbers("thresholds", thresholds, len(thresholds))
        self.b = _numbers("weights", weights, len(self.r))
        self.rho = _numbers("threshold_slopes", threshold_slopes, len(self.r))
        if self.rho[0] != 0 or any(b < a for a, b in zip(self.rho, self.rho[1:], strict=False)):
            raise ConfigError(
                f"threshold_slopes: found {self.rho}, expected 0 first, then non-decreasing numbers: "
                "thresholds must keep their order at every rate"
            )
        self.k = _numbers("weight_slopes", weight_slopes, len(self.r))
        if len(lead) > 2:
            raise ConfigError(f"lead: found {list(lead)}, expected at most two numbers, in s and s²")
        self.lead = _numbers("lead", [*lead, *[0.0] * (2 - len(lead))], 2)
        undone = saturation.inverse() if saturation is not None else DeadZones([0.0], [1.0])
        self.d: list[float] = undone.d.tolist()
        self.v: list[float] = undone.w.tolist()
        self.rates_um_s = _rates(self.b, self.k)

    def voltage(
        self,
        motion: Motion,
        state: Tensor | None = None,  # (batch, plays)
    ) -> tuple[Tensor, Tensor]:
        """Return the voltage before the output limits, and the state after it, without gradients."""
        h = self.initial_state(len(motion.yd)) if state is None else state.clone()
        yd, rate, acceleration = (part.detach().to(torch.float64).contiguous().numpy() for part in motion)
        u = np.empty_like(yd)
        numbers = [np.array(part) for part in (self.r, self.rho, self.b, self.k, self.lead, self.d, self.v)]
        _run(yd, rate, acceleration, *numbers, *self.rates_um_s, h.numpy(), u)
        return torch.from_numpy(u), h

    def initial_state(self, batch: int) -> Tensor:
        """Return the de-energised state. Shape: (batch, plays)."""
        return torch.zeros(batch, len(self.r), dtype=torch.float64)

    @property
    def inverse_weights(self) -> list[float]:
        """w' at rest, V/µm."""
        return inverse_numbers(self.r, self.b)[1]

    def stream(self, reference_filter: ReferenceFilter | None = None) -> CompensatorStream:
        """Return a scriptable stream, `u = step(y_d at t + preview)`, with the same bits as `forward`."""
        law = IndirectStream(self.r, self.rho, self.b, self.k, self.lead, self.d, self.v, *self.rates_um_s)
        return cast(CompensatorStream, Deployed(law, self, reference_filter))

    def extra_repr(self) -> str:
        return f"plays={len(self.r)}, T = {self.sample_period_s:g} s, preview={self.preview}"


def indirect_step(
    yd: float, rate: float, acceleration: float,
    r: list[float], rho: list[float], b: list[float], k: list[float],
    lead: list[float], d: list[float], v: list[float], slowest: float, fastest: float,
    r_now: list[float], w_now: list[float], r_inverse: list[float], w_inverse: list[float], h: list[float],
) -> float:  # fmt: skip
    """One sample of the law. The kernel and the stream compile this; the `_now` lists are work space."""
    x = dead_zones(yd + lead[0] * rate + lead[1] * acceleration, d, v)
    held = max(slowest, min(fastest, rate))
    for i in range(len(r)):
        r_now[i] = r[i] + rho[i] * abs(held)
        w_now[i] = b[i] + k[i] * held
    invert(r_now, w_now, r_inverse, w_inverse)
    u = 0.0
    for i in range(len(r)):
        h[i] = play(x, r_inverse[i], h[i])
        u += w_inverse[i] * h[i]
    return u


class IndirectStream(nn.Module):
    """The law, one sample at a time."""

    r: list[float]
    rho: list[float]
    b: list[float]
    k: list[float]
    lead: list[float]
    d: list[float]
    v: list[float]
    r_now: list[float]
    w_now: list[float]
    r_inverse: list[float]
    w_inverse: list[float]
    h: list[float]

    def __init__(
        self,
        r: list[float],
        rho: list[float],
        b: list[float],
        k: list[float],
        lead: list[float],
        d: list[float],
        v: list[float],
        slowest: float,
        fastest: float,
    ) -> None:
        super().__init__()
        self.r = r
        self.rho = rho
        self.b = b
        self.k = k
        self.lead = lead
        self.d = d
        self.v = v
        self.slowest = slowest
        self.fastest = fastest
        self.r_now = [0.0] * len(r)
        self.w_now = [0.0] * len(r)
        self.r_inverse = [0.0] * len(r)
        self.w_inverse = [0.0] * len(r)
        self.h = [0.0] * len(r)

    @torch.jit.export
    def reset(self) -> None:
        for i in range(len(self.h)):
            self.h[i] = 0.0

    @torch.jit.export
    def step(self, yd: float, rate: float, acceleration: float) -> float:
        return indirect_step(
            yd, rate, acceleration, self.r, self.rho, self.b, self.k, self.lead, self.d, self.v,
            self.slowest, self.fastest, self.r_now, self.w_now, self.r_inverse, self.w_inverse, self.h,
        )  # fmt: skip


# Each remains a plain function, which TorchScript reads, and the kernel can call it as well.
for _part in (play, dead_zone, dead_zones, invert):
    register_jitable(_part)
_indirect_step: Any = numba.njit(indirect_step)


@numba.njit  # not cached: numba would not notice changes of the functions it calls in other files
def _run(
    yd: np.ndarray, rate: np.ndarray, acceleration: np.ndarray,
    r: np.ndarray, rho: np.ndarray, b: np.ndarray, k: np.ndarray,
    lead: np.ndarray, d: np.ndarray, v: np.ndarray, slowest: float, fastest: float,
    h: np.ndarray, u: np.ndarray,
) -> None:  # fmt: skip
    r_now, w_now, r_inverse, w_inverse = (
        np.empty(len(r)),
        np.empty(len(r)),
        np.empty(len(r)),
        np.empty(len(r)),
    )
    for batch in range(yd.shape[0]):
        for t in range(yd.shape[1]):
            u[batch, t] = _indirect_step(
                yd[batch, t], rate[batch, t], acceleration[batch, t], r, rho, b, k, lead, d, v,
                slowest, fastest, r_now, w_now, r_inverse, w_inverse, h[batch],
            )  # fmt: skip


def _numbers(name: str, values: Sequence[float], count: int) -> list[float]:
    """Return `values` as floats, or zeros if there are none."""
    numbers = [float(value) for value in values] or [0.0] * count
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{name}: found {list(values)}, expected {count} finite numbers")
    return numbers


def _rates(b: list[float], k: list[float]) -> tuple[float, float]:
    """Return the rates, µm/s, between which all slopes of the model keep `LEAST_SLOPE` of those at rest."""
    slowest, fastest = -math.inf, math.inf
    for at_rest, per_rate in zip(np.cumsum(b).tolist(), np.cumsum(k).tolist(), strict=True):
        if per_rate > 0:
            slowest = max(slowest, -(1 - LEAST_SLOPE) * at_rest / per_rate)
        elif per_rate < 0:
            fastest = min(fastest, -(1 - LEAST_SLOPE) * at_rest / per_rate)
    return slowest, fastest
