"""The hysteresis of a diagnosis as one operator: plays through output functions, Bouc–Wen, Duhem.

    y = Σ_p Σ_i w_pi x_i (x_i / s)^p + w z + Σ_k w_k d_k / s^(k-1) + w_0

    h_i = max{v + a v² - r_i β(v̇), min{v - a v² + r_i β(v̇), h_i}},    β = 1 + b |v̇|
    x_i = c v + (h_i g_i - c v) (1 + l),    l = γ ln(1 + |v̇| / v̇₀)
    g_i = g = (1 + κ v)(1 + k v̇) where r_i > 0, and 1 - b (g - 1) where r_i = 0

z is a Bouc–Wen state, d_1 to d_3 are Duhem states; `torchpi.operators.hysteresis_rows` has their equations,
and the sources. v̇ is the difference to the sample before over T, through a low-pass of `rate_filter_s`: the
sample rate enters nowhere else.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from torchpi.errors import StageError
from torchpi.operators.base import Operator
from torchpi.operators.compiled import as_array, in_threads, njit
from torchpi.operators.generalised_play import clamp_play
from torchpi.operators.hysteresis_rows import (
    bend,
    bouc_wen,
    duhem,
    gain_inside,
    loop_widening,
    straight_gain,
    threshold_widening,
)
from torchpi.operators.relaxations import relaxations

IDENTITY = {
    "asymmetry_per_v": 0.0,
    "incongruence_per_v": 0.0,
    "straight_share": 0.0,
    "weight_s_per_v": 0.0,
    "threshold_s_per_v": 0.0,
    "loop_per_e": 0.0,
    "chord_share": 1.0,
    "reference_rate_v_s": 1.0,
    "rate_filter_s": 0.0,
}
"""The shape of a hysteresis without effects inside it."""
OF_BOUC_WEN = ("sigma_v", "beta", "exponent")
OF_DUHEM = ("alpha_per_v",)
NOT_TRAINED = ("rate_filter_s", *OF_BOUC_WEN, *OF_DUHEM)
DUHEM_STATES = 3
TILE = 256
"""Samples from one set of stored states to the next."""


class Hysteresis(Operator):
    """A rate-independent hysteresis, and what effects inside it make of it.

    The state: one h for each play, the last voltage, the filtered rate, then z and d_1 to d_3 as far as they
    are there. Weights and shape are trained, but for `rate_filter_s` and the shapes of z and d, which are
    plain numbers. The derivative by the asymmetry at exactly 0 is that from above: below it, the play with
    r = 0 has memory.

    Args:
        sample_period_s: T.
        thresholds_v: r, none negative.
        weights: w, as many as plays × `degree` (all of one power, then the next), then those of z, of d_1 to
            d_3, and the constant.
        degree: Of the output functions; 1 is a weighted sum.
        scale_v: s.
        bouc_wen: Whether z is there.
        duhem: Whether d is there.
        shape: Parameters inside, as in `IDENTITY` where they are not named; those of z and d by need.

    Raises:
        StageError: Another number of weights, or a shape parameter that is missing or unknown.
    """

    weights: nn.Parameter
    asymmetry_per_v: nn.Parameter
    thresholds_v: Tensor

    def __init__(
        self,
        sample_period_s: float,
        thresholds_v: Sequence[float] | Tensor | np.ndarray,
        weights: Sequence[float] | Tensor | np.ndarray,
        degree: int = 1,
        scale_v: float = 1.0,
        bouc_wen: bool = False,
        duhem: bool = False,
        shape: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__()
        self.sample_period_s = sample_period_s
        self.degree, self.scale_v = int(degree), float(scale_v)
        self.bouc_wen, self.duhem = bool(bouc_wen), bool(duhem)
        self.register_buffer("thresholds_v", torch.as_tensor(thresholds_v, dtype=torch.float64).clone())
        self.weights = nn.Parameter(torch.as_tensor(weights, dtype=torch.float64).clone())
        wanted = len(self.thresholds_v) * degree + self.others + 1
        if self.weights.shape != (wanted,):
            raise StageError(f"weights: found {self.weights.numel()}, want {wanted}: plays × degree and more")
        needed = (*IDENTITY, *(OF_BOUC_WEN if bouc_wen else ()), *(OF_DUHEM if duhem else ()))
        values = {**IDENTITY, **(shape or {})}
        for name in (*needed, *values):
            if name not in values or name not in needed:
                found = "none" if name in needed else f"{values[name]:g}"
                raise StageError(f"{name}: found {found} in this hysteresis, want {', '.join(needed)}")
        self.trained = [name for name in needed if name not in NOT_TRAINED]
        for name in self.trained:
            self.register_parameter(name, nn.Parameter(torch.tensor(values[name], dtype=torch.float64)))
        self.fixed = {name: float(values[name]) for name in needed if name in NOT_TRAINED}

    @property
    def others(self) -> int:
        """States that are no plays, as many as their weights."""
        return self.bouc_wen + DUHEM_STATES * self.duhem

    def shape(self) -> dict[str, float]:
        """The present parameters inside."""
        return {name: getattr(self, name).item() for name in self.trained} | self.fixed

    def settings(self) -> dict[str, Any]:
        """The constructor's arguments, without the period, as they are now."""
        return {
            "thresholds_v": self.thresholds_v.tolist(),
            "weights": self.weights.tolist(),
            "degree": self.degree,
            "scale_v": self.scale_v,
            "bouc_wen": self.bouc_wen,
            "duhem": self.duhem,
            "shape": self.shape(),
        }

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, len(self.thresholds_v) + 2 + self.others, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time), V
        state: Tensor | None = None,  # (batch, states)
    ) -> tuple[Tensor, Tensor]:  # (batch, time), µm; (batch, states)
        state = self.initial_state(len(x)) if state is None else state
        v = x.to("cpu", torch.float64)
        plays, weights = len(self.thresholds_v), self.weights
        h, before, rate_before, others = state.split([plays, 1, 1, self.others], 1)
        rate, filtered = self._rate(v, before, rate_before)
        shape = {name: getattr(self, name) for name in self.trained}
        gain = gain_inside(v, rate, shape["incongruence_per_v"], shape["weight_s_per_v"])  # type: ignore[arg-type]
        loop = _LoopWidening.apply(rate, shape["loop_per_e"], shape["reference_rate_v_s"])
        bent = bend(v, shape["asymmetry_per_v"])  # type: ignore[arg-type]
        y, h = _Plays.apply(
            shape["chord_share"] * v,
            v + bent,
            v - bent,
            threshold_widening(rate, shape["threshold_s_per_v"]),  # type: ignore[arg-type]
            gain,
            straight_gain(gain, shape["straight_share"]),  # type: ignore[arg-type]
            loop,
            weights[: plays * self.degree].reshape(self.degree, plays),
            h,
            self.thresholds_v,
            self.scale_v,
        )
        ends = []
        for weight, z0, (kernels, numbers, scale) in zip(
            weights[plays * self.degree : -1], others.unbind(1), self._families(), strict=True
        ):
            z = _State.apply(v, before[:, 0], z0, kernels, numbers)
            ends.append(z[:, -1:])
            if kernels[0] is _bouc_wen_forward:
                z = z * gain
                z = z + z * loop
            y = y + weight * (z / scale)
        return (y + weights[-1]).to(x), torch.cat([h, v[:, -1:], filtered, *ends], 1)

    def stream(self) -> "HysteresisStream":
        return HysteresisStream(self)

    def _rate(self, v: Tensor, before: Tensor, rate_before: Tensor) -> tuple[Tensor, Tensor]:
        """v̇, (batch, time), V/s, and its last value, (batch, 1)."""
        rate = torch.diff(v, dim=1, prepend=before) / self.sample_period_s
        one = torch.ones(1, dtype=torch.float64)
        kept = self._kept() * one
        return relaxations(rate, kept, one - kept, kept, 1.0 - kept[0], rate_before)

    def _kept(self) -> float:
        """What the filter of the rate keeps in one period."""
        tau_s = self.fixed["rate_filter_s"]
        return math.exp(-self.sample_period_s / tau_s) if tau_s > 0.0 else 0.0

    def _families(self) -> list[tuple[Any, tuple[float, ...], float]]:
        """For each state that is no play its kernels, its numbers, and what it is divided by."""
        fixed, found = self.fixed, []
        if self.bouc_wen:
            numbers = tuple(fixed[name] for name in OF_BOUC_WEN)
            found.append(((_bouc_wen_forward, _bouc_wen_backward), numbers, 1.0))
        if self.duhem:
            for k in range(DUHEM_STATES):
                numbers = (fixed["alpha_per_v"], k + 1.0, 0.0)
                found.append(((_duhem_forward, _duhem_backward), numbers, self.scale_v**k))
        return found


class HysteresisStream(nn.Module):
    """The hysteresis, one sample at a time."""

    r: list[float]
    w: list[float]
    h: list[float]
    d: list[float]

    def __init__(self, hysteresis: Hysteresis) -> None:
        super().__init__()
        shape = {name: 1.0 for name in (*OF_BOUC_WEN, *OF_DUHEM)} | hysteresis.shape()
        self.period_s = hysteresis.sample_period_s
        self.kept = hysteresis._kept()
        self.degree, self.scale = hysteresis.degree, hysteresis.scale_v
        self.has_bouc_wen, self.has_duhem = hysteresis.bouc_wen, hysteresis.duhem
        self.r, self.w = hysteresis.thresholds_v.tolist(), hysteresis.weights.tolist()
        self.asymmetry, self.incongruence = shape["asymmetry_per_v"], shape["incongruence_per_v"]
        self.by_rate, self.threshold_by_rate = shape["weight_s_per_v"], shape["threshold_s_per_v"]
        self.loop, self.reference = shape["loop_per_e"], shape["reference_rate_v_s"]
        self.chord, self.straight = shape["chord_share"], shape["straight_share"]
        self.sigma, self.beta, self.exponent = (shape[name] for name in OF_BOUC_WEN)
        self.alpha = shape["alpha_per_v"]
        self.h, self.d = [0.0] * len(self.r), [0.0] * DUHEM_STATES
        self.z = 0.0
        self.before = 0.0
        self.rate = 0.0

    @torch.jit.export
    def reset(self) -> None:
        for i in range(len(self.h)):
            self.h[i] = 0.0
        for k in range(len(self.d)):
            self.d[k] = 0.0
        self.z = 0.0
        self.before = 0.0
        self.rate = 0.0

    @torch.jit.export
    def step(self, x: float) -> float:
        self.rate = self.kept * self.rate + (1.0 - self.kept) * ((x - self.before) / self.period_s)
        bent = bend(x, self.asymmetry)
        rising, falling = x + bent, x - bent
        width = threshold_widening(self.rate, self.threshold_by_rate)
        gain = gain_inside(x, self.rate, self.incongruence, self.by_rate)
        straight = straight_gain(gain, self.straight)
        chord, loop = self.chord * x, loop_widening(self.rate, self.loop, self.reference)
        plays, y = len(self.r), 0.0
        for i in range(plays):
            r = self.r[i] * width
            self.h[i] = clamp_play(rising - r, falling + r, self.h[i])
            inner = self.h[i] * (gain if self.r[i] > 0.0 else straight)
            inner = inner + (inner - chord) * loop
            term = self.w[(self.degree - 1) * plays + i]
            for p in range(self.degree - 2, -1, -1):
                term = term * (inner / self.scale) + self.w[p * plays + i]
            y = y + term * inner
        place = plays * self.degree
        if self.has_bouc_wen:
            self.z = bouc_wen(self.z, x - self.before, self.sigma, self.beta, self.exponent)
            z = self.z * gain
            y = y + self.w[place] * (z + z * loop)
            place += 1
        if self.has_duhem:
            scale = 1.0
            for k in range(len(self.d)):
                self.d[k] = duhem(self.d[k], x, self.before, self.alpha, k + 1)
                y = y + self.w[place] * (self.d[k] / scale)
                scale = scale * self.scale
                place += 1
        self.before = x
        return y + self.w[place]


class _Plays(torch.autograd.Function):
    """The weighted sum of the plays, and their last states."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, Tensor]:
        *tensors, scale = inputs
        signals, (weights, h0, r) = tensors[:7], tensors[7:]
        up = signals[1]
        y, h = torch.empty_like(up), h0.detach().clone()
        stored = up.new_empty(len(up), -(-up.shape[1] // TILE), len(r))
        arrays = [as_array(signal) for signal in signals]
        in_threads(
            _plays_forward, len(up), *arrays, as_array(weights), as_array(r), scale,
            h.numpy(), stored.numpy(), y.numpy(),
        )  # fmt: skip
        ctx.scale = scale
        ctx.save_for_backward(*signals, weights, r, stored)
        return y, h

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        *signals, weights, r, stored = ctx.saved_tensors
        by = [torch.zeros_like(signal) for signal in signals]
        by_h = gradients[1].clone(memory_format=torch.contiguous_format)
        by_weights = weights.new_zeros(len(by_h), *weights.shape)
        in_threads(
            _plays_backward, len(by_h), *(as_array(signal) for signal in signals), as_array(weights),
            as_array(r), ctx.scale, as_array(stored), as_array(gradients[0]),
            *(part.numpy() for part in by), by_weights.numpy(), by_h.numpy(),
        )  # fmt: skip
        return *by, by_weights.sum(0), by_h, None, None


_clamp_play = njit(clamp_play)


@njit
def _plays_forward(
    first: int, last: int, chord: np.ndarray, up: np.ndarray, down: np.ndarray, width: np.ndarray,
    gain: np.ndarray, straight: np.ndarray, loop: np.ndarray, w: np.ndarray, r: np.ndarray, scale: float,
    h: np.ndarray, stored: np.ndarray, y: np.ndarray,
) -> None:  # fmt: skip
    part = np.empty(len(r))
    for row in range(first, last):
        now = h[row]
        for t in range(up.shape[1]):
            if t % TILE == 0:
                stored[row, t // TILE] = now
            _advance(up[row, t], down[row, t], width[row, t], r, now)
            grown, kept, looped, middle = gain[row, t], straight[row, t], loop[row, t], chord[row, t]
            for i in range(len(r)):
                x = now[i] * (grown if r[i] > 0.0 else kept)
                x = x + (x - middle) * looped
                term = w[len(w) - 1, i]
                for p in range(len(w) - 2, -1, -1):
                    term = term * (x / scale) + w[p, i]
                part[i] = term * x
            total = 0.0
            for i in range(len(r)):
                total = total + part[i]
            y[row, t] = total


@njit
def _advance(rising: float, falling: float, width: float, r: np.ndarray, h: np.ndarray) -> None:
    for i in range(len(r)):
        h[i] = _clamp_play(rising - r[i] * width, falling + r[i] * width, h[i])


@njit
def _plays_backward(
    first: int, last: int, chord: np.ndarray, up: np.ndarray, down: np.ndarray, width: np.ndarray,
    gain: np.ndarray, straight: np.ndarray, loop: np.ndarray, w: np.ndarray, r: np.ndarray, scale: float,
    stored: np.ndarray, gy: np.ndarray, gchord: np.ndarray, gup: np.ndarray, gdown: np.ndarray,
    gwidth: np.ndarray, ggain: np.ndarray, gstraight: np.ndarray, gloop: np.ndarray, gw: np.ndarray,
    gh: np.ndarray,
) -> None:  # fmt: skip
    # A state is one end of its play at the last sample that pushed it: the gradient waits in gh until then.
    tile = np.empty((TILE + 1, len(r)))
    for row in range(first, last):
        carried = gh[row]
        for index in range(stored.shape[1] - 1, -1, -1):
            begin, end = index * TILE, min(index * TILE + TILE, up.shape[1])
            tile[0] = stored[row, index]
            for t in range(begin, end):
                tile[t - begin + 1] = tile[t - begin]
                _advance(up[row, t], down[row, t], width[row, t], r, tile[t - begin + 1])
            for t in range(end - 1, begin - 1, -1):
                before, now = tile[t - begin], tile[t - begin + 1]
                looped, middle, g = loop[row, t], chord[row, t], gy[row, t]
                by_chord, by_gain, by_straight, by_loop = 0.0, 0.0, 0.0, 0.0
                by_up, by_down, by_width = 0.0, 0.0, 0.0
                for i in range(len(r)):
                    grown = gain[row, t] if r[i] > 0.0 else straight[row, t]
                    inner = now[i] * grown
                    x = inner + (inner - middle) * looped
                    slope, power = 0.0, x
                    for p in range(len(w)):
                        gw[row, p, i] += g * power
                        power = power * (x / scale)
                    for p in range(len(w) - 1, -1, -1):
                        slope = slope * (x / scale) + (p + 1) * w[p, i]
                    by_x = g * slope
                    by_inner = by_x * (1.0 + looped)
                    by_chord -= by_x * looped
                    by_loop += by_x * (inner - middle)
                    if r[i] > 0.0:
                        by_gain += by_inner * now[i]
                    else:
                        by_straight += by_inner * now[i]
                    waiting = carried[i] + by_inner * grown
                    low, high = up[row, t] - r[i] * width[row, t], down[row, t] + r[i] * width[row, t]
                    if before[i] <= low or low >= high:
                        by_up += waiting
                        by_width -= r[i] * waiting
                        carried[i] = 0.0
                    elif before[i] >= high:
                        by_down += waiting
                        by_width += r[i] * waiting
                        carried[i] = 0.0
                    else:
                        carried[i] = waiting
                gchord[row, t], gup[row, t], gdown[row, t] = by_chord, by_up, by_down
                gwidth[row, t], ggain[row, t], gstraight[row, t] = by_width, by_gain, by_straight
                gloop[row, t] = by_loop


class _LoopWidening(torch.autograd.Function):
    """`loop_widening` sample by sample: torch's own logarithm has other bits than the stream's."""

    @staticmethod
    def forward(ctx: Any, rate: Tensor, per_e: Tensor, reference: Tensor) -> Tensor:
        ctx.save_for_backward(rate, per_e, reference)
        loop = torch.empty_like(rate)
        _loop_forward(as_array(rate), per_e.item(), reference.item(), loop.numpy())
        return loop

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        rate, per_e, reference = ctx.saved_tensors
        by_size = gradients[0] * per_e / (reference + rate.abs())
        by_reference = -(by_size * rate.abs()).sum() / reference
        return by_size * rate.sign(), (gradients[0] * torch.log1p(rate.abs() / reference)).sum(), by_reference


_loop_widening = njit(loop_widening)


@njit
def _loop_forward(rate: np.ndarray, per_e: float, reference: float, loop: np.ndarray) -> None:
    for row in range(rate.shape[0]):
        for t in range(rate.shape[1]):
            loop[row, t] = _loop_widening(rate[row, t], per_e, reference)


class _State(torch.autograd.Function):
    """A state that each move of v carries on: Bouc–Wen, Duhem."""

    @staticmethod
    def forward(
        ctx: Any, v: Tensor, before: Tensor, z0: Tensor, kernels: Any, numbers: tuple[float, ...]
    ) -> Tensor:
        z = torch.empty_like(v)
        forward, ctx.kernel = kernels
        ctx.numbers = numbers
        forward(as_array(v), as_array(before), as_array(z0), *numbers, z.numpy())
        ctx.save_for_backward(v, before, z0, z)
        return z

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        v, before, z0, z = ctx.saved_tensors
        by_v, by_before, by_z0 = torch.zeros_like(v), torch.zeros_like(before), torch.zeros_like(z0)
        ctx.kernel(
            *(as_array(part) for part in (v, before, z0)), *ctx.numbers, as_array(z), as_array(gradients[0]),
            by_v.numpy(), by_before.numpy(), by_z0.numpy(),
        )  # fmt: skip
        return by_v, by_before, by_z0, None, None


_bouc_wen = njit(bouc_wen)
_duhem = njit(duhem)


@njit
def _bouc_wen_forward(
    v: np.ndarray, before: np.ndarray, z0: np.ndarray, sigma: float, beta: float, n: float, z: np.ndarray
) -> None:
    for row in range(v.shape[0]):
        state, last = z0[row], before[row]
        for t in range(v.shape[1]):
            state = _bouc_wen(state, v[row, t] - last, sigma, beta, n)
            z[row, t] = state
            last = v[row, t]


@njit
def _duhem_forward(
    v: np.ndarray, before: np.ndarray, z0: np.ndarray, alpha: float, power: float, _: float, z: np.ndarray
) -> None:
    for row in range(v.shape[0]):
        state, last = z0[row], before[row]
        for t in range(v.shape[1]):
            state = _duhem(state, v[row, t], last, alpha, int(power))
            z[row, t] = state
            last = v[row, t]


@njit
def _bouc_wen_backward(
    v: np.ndarray, before: np.ndarray, z0: np.ndarray, sigma: float, beta: float, n: float, z: np.ndarray,
    gz: np.ndarray, gv: np.ndarray, gbefore: np.ndarray, gz0: np.ndarray,
) -> None:  # fmt: skip
    for row in range(v.shape[0]):
        carried = 0.0
        for t in range(v.shape[1] - 1, -1, -1):
            carried += gz[row, t]
            last = v[row, t - 1] if t > 0 else before[row]
            by_z, by_move = _bouc_wen_slopes(
                z[row, t - 1] if t > 0 else z0[row], v[row, t] - last, sigma, beta, n
            )
            gv[row, t] += carried * by_move
            if t > 0:
                gv[row, t - 1] -= carried * by_move
            else:
                gbefore[row] -= carried * by_move
            carried = carried * by_z
        gz0[row] = carried


@njit
def _bouc_wen_slopes(z: float, dv: float, sigma: float, beta: float, n: float) -> tuple[float, float]:
    """How the state after a move changes with that before it, and with the move: the derivative of
    `bouc_wen`, line by line."""
    pieces = int(abs(dv) / sigma * 20.0) + 1
    move = dv / pieces
    by_z, by_move = 1.0, 0.0
    for _ in range(pieces):
        at, at_by_z, at_by_move = z, by_z, by_move
        for part in (0.5, 1.0):
            sign = 1.0 if at * move >= 0.0 else -1.0
            outward = 1.0 - beta + beta * sign
            slope = 1.0 - abs(at) ** n * outward
            steepness = -n * abs(at) ** (n - 1.0) * np.sign(at) * outward if at != 0.0 else 0.0
            step = part * move / sigma
            at_by_move = by_move + part / (pieces * sigma) * slope + step * steepness * at_by_move
            at_by_z = by_z + step * steepness * at_by_z
            at = z + step * slope
        z, by_z, by_move = at, at_by_z, at_by_move
    return by_z, by_move


@njit
def _duhem_backward(
    v: np.ndarray, before: np.ndarray, z0: np.ndarray, alpha: float, power: float, _: float, z: np.ndarray,
    gz: np.ndarray, gv: np.ndarray, gbefore: np.ndarray, gz0: np.ndarray,
) -> None:  # fmt: skip
    for row in range(v.shape[0]):
        carried = 0.0
        for t in range(v.shape[1] - 1, -1, -1):
            carried += gz[row, t]
            last = v[row, t - 1] if t > 0 else before[row]
            state = z[row, t - 1] if t > 0 else z0[row]
            move, middle = v[row, t] - last, 0.5 * (v[row, t] + last)
            rest = np.exp(-alpha * abs(move))
            by_target = (1.0 - rest) * power * middle ** (power - 1.0) * 0.5
            by_move = (middle**power - state) * alpha * np.sign(move) * rest
            gv[row, t] += carried * (by_target + by_move)
            if t > 0:
                gv[row, t - 1] += carried * (by_target - by_move)
            else:
                gbefore[row] += carried * (by_target - by_move)
            carried = carried * rest
        gz0[row] = carried
