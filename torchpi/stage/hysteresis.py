"""The hysteresis of a diagnosis as one operator: plays with output functions, Bouc–Wen and Duhem states.

    y = Σ_i F_i(x_i) + w z + Σ_k w_k d_k / s^(k-1) + w_0

    h_i = max{v + a v² - r_i β(v̇), min{v - a v² + r_i β(v̇), h_i}},    β = 1 + b |v̇|
    x_i = c v + (h_i g_i - c v) (1 + l),    l = γ ln(1 + |v̇| / v̇₀)
    g_i = g = (1 + κ v)(1 + k v̇) where r_i > 0, and 1 - q (g - 1) where r_i = 0

F_i is piecewise linear with F_i(0) = 0 and a slope w_ki on each of its pieces of equal length: a Preisach
operator in play form, with one cell of its density per piece (Krejčí, 1996). One piece is a weighted sum.

With `relaxation_s` each play with r_i > 0 relaxes towards the h_i above, see
`torchpi.stage.effects.actuator.relaxing_plays`.

z is a Bouc–Wen state and the d_k are a bank of Duhem states; `torchpi.operators.hysteresis_rows` gives their
equations and the sources. v̇ is the backward difference over T, through a low-pass of time constant
`rate_filter_s`; without relaxation the sample rate enters nowhere else.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torchpi.errors import StageError
from torchpi.operators.base import Operator
from torchpi.operators.generalised_play import clamp_play
from torchpi.operators.hysteresis_rows import (
    DUHEM_POWERS,
    bend,
    bouc_wen,
    duhem,
    gain_inside,
    kept_after,
    loop_widening,
    offsets_of,
    piece_of,
    straight_gain,
    threshold_widening,
    towards,
)
from torchpi.operators.relaxations import relaxations
from torchpi.stage.carried_state import BOUC_WEN, DUHEM, CarriedState
from torchpi.stage.effects.actuator.relaxing_plays import RelaxingPlays
from torchpi.stage.loop_widening import LoopWidening
from torchpi.stage.play_sum import PlaySum

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
    "relaxation_s": 0.0,
}
"""Shape parameters of a hysteresis without effects inside it."""
OF_BOUC_WEN = ("sigma_v", "beta", "exponent")
OF_DUHEM = ("alpha_per_v",)
NOT_TRAINED = ("rate_filter_s", *OF_BOUC_WEN, *OF_DUHEM)
MOST_PLAYS = 10_000


class Hysteresis(Operator):
    """A rate-independent hysteresis, and what effects inside it make of it.

    The state holds h of each play, the last voltage, the filtered rate, then z and the d_k if they exist.
    Weights and shape parameters are trained, except `rate_filter_s` and the shape parameters of z and d,
    which are plain numbers. The derivative by the asymmetry at exactly 0 is taken from above, because below
    0 the play with r = 0 has memory. `relaxation_s` has no gradient at exactly 0.

    Args:
        sample_period_s: T.
        thresholds_v: r, none negative.
        weights: w, one for each play × `pieces` (all of one piece, then the next), then those of z and of the
            d_k, then the constant.
        pieces: Number of pieces of each output function; 1 is a weighted sum.
        range_v: Where the first piece begins and the last one ends; both continue beyond.
        scale_v: s.
        bouc_wen: Whether there is a z.
        duhem: Whether there are d_k.
        shape: Shape parameters; `IDENTITY` has the defaults. Those of z and d are required if these exist.

    Raises:
        StageError: A wrong number of weights, or a shape parameter that is missing or unknown.
    """

    weights: nn.Parameter
    asymmetry_per_v: nn.Parameter
    relaxation_s: nn.Parameter
    thresholds_v: Tensor

    def __init__(
        self,
        sample_period_s: float,
        thresholds_v: Sequence[float] | Tensor | np.ndarray,
        weights: Sequence[float] | Tensor | np.ndarray,
        pieces: int = 1,
        range_v: Sequence[float] = (-1.0, 1.0),
        scale_v: float = 1.0,
        bouc_wen: bool = False,
        duhem: bool = False,
        shape: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__()
        self.sample_period_s = sample_period_s
        self.pieces, self.scale_v = int(pieces), float(scale_v)
        self.low_v, self.high_v = map(float, range_v)
        if self.pieces < 1 or (self.pieces > 1 and not self.low_v < self.high_v):
            between = f"{pieces} between {self.low_v:g} and {self.high_v:g} V"
            raise StageError(f"pieces: found {between}, expected one, or several over a range")
        self.bouc_wen, self.duhem = bool(bouc_wen), bool(duhem)
        self.register_buffer("thresholds_v", torch.as_tensor(thresholds_v, dtype=torch.float64).clone())
        self.weights = nn.Parameter(torch.as_tensor(weights, dtype=torch.float64).clone())
        if len(self.thresholds_v) > MOST_PLAYS:
            raise StageError(f"thresholds_v: found {len(self.thresholds_v)}, expected at most {MOST_PLAYS}")
        expected = len(self.thresholds_v) * self.pieces + self.others + 1
        if self.weights.shape != (expected,):
            count = self.weights.numel()
            raise StageError(
                f"weights: found {count}, expected {expected}: plays × pieces, other states and an offset"
            )
        needed = (*IDENTITY, *(OF_BOUC_WEN if bouc_wen else ()), *(OF_DUHEM if duhem else ()))
        values = {**IDENTITY, **(shape or {})}
        for name in (*needed, *values):
            if name not in values or name not in needed:
                found = "none" if name in needed else f"{values[name]:g}"
                raise StageError(f"{name}: found {found} in this hysteresis, expected {', '.join(needed)}")
        self.trained = [name for name in needed if name not in NOT_TRAINED]
        for name in self.trained:
            self.register_parameter(name, nn.Parameter(torch.tensor(values[name], dtype=torch.float64)))
        self.fixed = {name: float(values[name]) for name in needed if name in NOT_TRAINED}

    @property
    def others(self) -> int:
        """Number of states other than plays, each of which has one weight."""
        return self.bouc_wen + len(DUHEM_POWERS) * self.duhem

    @property
    def is_weighted_sum(self) -> bool:
        """Whether it is a weighted sum of plays: no output function bends, and there are no other states."""
        return self.pieces == 1 and not self.others

    def shape(self) -> dict[str, float]:
        """Return the present shape parameters."""
        return {name: getattr(self, name).item() for name in self.trained} | self.fixed

    def settings(self) -> dict[str, Any]:
        """Return the present arguments of the constructor, without the period."""
        return {
            "thresholds_v": self.thresholds_v.tolist(),
            "weights": self.weights.tolist(),
            "pieces": self.pieces,
            "range_v": [self.low_v, self.high_v],
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
        loop = LoopWidening.apply(rate, shape["loop_per_e"], shape["reference_rate_v_s"])
        bent = bend(v, shape["asymmetry_per_v"])  # type: ignore[arg-type]
        signals: tuple[Any, ...] = (
            shape["chord_share"] * v,
            v + bent,
            v - bent,
            threshold_widening(rate, shape["threshold_s_per_v"]),  # type: ignore[arg-type]
            gain,
            straight_gain(gain, shape["straight_share"]),
            loop,
        )
        slopes, offsets = self._output_functions()
        if self.relaxation_s.item() > 0.0:
            y, h = self._relaxing(signals, slopes, offsets, h)
        else:
            y, h = PlaySum.apply(*signals, slopes, offsets, h, self.thresholds_v, self.low_v, self.piece_v)
        ends = []
        for weight, z0, (kernels, numbers, scale) in zip(
            weights[plays * self.pieces : -1], others.unbind(1), self._families(), strict=True
        ):
            z = CarriedState.apply(v, before[:, 0], z0, kernels, numbers)
            ends.append(z[:, -1:])
            if kernels is BOUC_WEN:
                z = z * gain
                z = z + z * loop
            y = y + weight * (z / scale)
        return (y + weights[-1]).to(x), torch.cat([h, v[:, -1:], filtered, *ends], 1)

    def stream(self) -> "HysteresisStream":
        return HysteresisStream(self)

    def late(self) -> Tensor:
        """Return e^{-T/τ}, the share of its distance to the target that a relaxing play keeps in a period."""
        if self.relaxation_s.item() > 0.0:
            return torch.exp(-self.sample_period_s / self.relaxation_s)
        return torch.zeros_like(self.relaxation_s)

    @property
    def piece_v(self) -> float:
        """Length of a piece."""
        return (self.high_v - self.low_v) / self.pieces

    def _output_functions(self) -> tuple[Tensor, Tensor]:
        """Return slopes and offsets of the F_i, (pieces, plays) each."""
        plays = len(self.thresholds_v)
        slopes = self.weights[: plays * self.pieces].reshape(self.pieces, plays)
        return slopes, torch.stack(offsets_of(slopes, self.low_v, self.piece_v))

    def _relaxing(
        self, signals: tuple[Tensor, ...], slopes: Tensor, offsets: Tensor, h0: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the sum of relaxing plays, each through a `PlaySum` of threshold 0, and the last states."""
        chord, up, down, width, gain, straight, loop = signals
        states = RelaxingPlays.apply(up, down, width, self.late(), h0, self.thresholds_v)
        y, none, start = torch.zeros_like(up), self.thresholds_v.new_zeros(1), torch.zeros_like(h0[:, :1])
        for i, r in enumerate(self.thresholds_v.tolist()):
            h, grown = states[..., i], gain if r > 0.0 else straight
            part, _ = PlaySum.apply(
                chord, h, h, width, grown, grown, loop, slopes[:, i : i + 1], offsets[:, i : i + 1],
                start, none, self.low_v, self.piece_v,
            )  # fmt: skip
            y = y + part
        return y, states[:, -1]

    def _rate(self, v: Tensor, before: Tensor, rate_before: Tensor) -> tuple[Tensor, Tensor]:
        """Return v̇, (batch, time), V/s, and its last value, (batch, 1)."""
        rate = torch.diff(v, dim=1, prepend=before) / self.sample_period_s
        one = torch.ones(1, dtype=torch.float64)
        kept = self._kept() * one
        return relaxations(rate, kept, one - kept, kept, 1.0 - kept[0], rate_before)

    def _kept(self) -> float:
        """Return the share of its value that the filter of the rate keeps over one period."""
        return kept_after(self.sample_period_s, self.fixed["rate_filter_s"])

    def _families(self) -> list[tuple[Any, tuple[float, ...], float]]:
        """Return kernels, parameters and divisor of each state that is not a play."""
        fixed, found = self.fixed, []
        if self.bouc_wen:
            numbers = tuple(fixed[name] for name in OF_BOUC_WEN)
            found.append((BOUC_WEN, numbers, 1.0))
        if self.duhem:
            for power in DUHEM_POWERS:
                numbers = (fixed["alpha_per_v"], float(power), 0.0)
                found.append((DUHEM, numbers, self.scale_v ** (power - 1)))
        return found


class HysteresisStream(nn.Module):
    """The hysteresis, one sample at a time."""

    r: list[float]
    w: list[float]
    c: list[float]
    others: list[float]
    h: list[float]
    d: list[float]
    alpha: float
    power: list[int]
    scales: list[float]

    def __init__(self, hysteresis: Hysteresis) -> None:
        super().__init__()
        shape = {name: 1.0 for name in (*OF_BOUC_WEN, *OF_DUHEM)} | hysteresis.shape()
        self.period_s = hysteresis.sample_period_s
        self.kept = hysteresis._kept()
        self.late = hysteresis.late().item()
        self.pieces, self.low, self.piece = hysteresis.pieces, hysteresis.low_v, hysteresis.piece_v
        self.scale = hysteresis.scale_v
        self.has_bouc_wen, self.has_duhem = hysteresis.bouc_wen, hysteresis.duhem
        self.r = hysteresis.thresholds_v.tolist()
        slopes, offsets = hysteresis._output_functions()
        self.w, self.c = slopes.flatten().tolist(), offsets.flatten().tolist()
        self.others = hysteresis.weights.tolist()[len(self.w) :]
        self.asymmetry, self.incongruence = shape["asymmetry_per_v"], shape["incongruence_per_v"]
        self.by_rate, self.threshold_by_rate = shape["weight_s_per_v"], shape["threshold_s_per_v"]
        self.loop, self.reference = shape["loop_per_e"], shape["reference_rate_v_s"]
        self.chord, self.straight = shape["chord_share"], shape["straight_share"]
        self.sigma, self.beta, self.exponent = (shape[name] for name in OF_BOUC_WEN)
        self.alpha, self.power = shape["alpha_per_v"], list(DUHEM_POWERS)
        self.scales = [self.scale ** (power - 1) for power in self.power]
        self.plain = self.pieces == 1 and all(shape[name] == value for name, value in IDENTITY.items())
        self.h, self.d = [0.0] * len(self.r), [0.0] * len(DUHEM_POWERS)
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
        gain = gain_inside(x, self.rate, self.incongruence, self.by_rate)
        loop = loop_widening(self.rate, self.loop, self.reference)
        y = self._sum_of_plain_plays(x) if self.plain else self._sum_of_plays(x, gain, loop)
        place = 0
        if self.has_bouc_wen:
            self.z = bouc_wen(self.z, x - self.before, self.sigma, self.beta, self.exponent)
            z = self.z * gain
            y = y + self.others[place] * (z + z * loop)
            place += 1
        if self.has_duhem:
            for k in range(len(self.d)):
                self.d[k] = duhem(self.d[k], x, self.before, self.alpha, self.power[k])
                y = y + self.others[place] * (self.d[k] / self.scales[k])
                place += 1
        self.before = x
        return y + self.others[place]

    # TorchScript interprets each loop. What it need not look up or compute for a play is most of a step.

    def _sum_of_plain_plays(self, x: float) -> float:
        """Return what `_sum_of_plays` returns, to the last bit, if nothing acts inside."""
        r, w, h, y = self.r, self.w, self.h, 0.0
        for i in range(len(r)):
            state = clamp_play(x - r[i], x + r[i], h[i])
            h[i] = state
            y = y + w[i] * state
        return y

    def _sum_of_plays(self, x: float, gain: float, loop: float) -> float:
        bent = bend(x, self.asymmetry)
        rising, falling = x + bent, x - bent
        width = threshold_widening(self.rate, self.threshold_by_rate)
        straight, chord = straight_gain(gain, self.straight), self.chord * x
        r, w, c, h, late = self.r, self.w, self.c, self.h, self.late
        low, piece, pieces = self.low, self.piece, self.pieces
        plays, y = len(r), 0.0
        for i in range(plays):
            wide, has_memory = r[i] * width, r[i] > 0.0
            bound = clamp_play(rising - wide, falling + wide, h[i])
            h[i] = towards(bound, h[i], late if has_memory else 0.0)
            inner = h[i] * (gain if has_memory else straight)
            inner = inner + (inner - chord) * loop
            place = piece_of(inner, low, piece, pieces) * plays + i
            y = y + (c[place] + w[place] * inner)
        return y
