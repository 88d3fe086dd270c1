"""A direct inverse corrected by a model of the stage, which predicts the error that the inverse leaves.

    u_0 = the direct inverse of y_d                                     eq. 8
    e_p = y_d - F[u_p]                                                  F: eq. 8 read forwards, from u to y
    u_{p+1}(k) = u_p(k) + Σ_j L_p(j) e_p(k + j),   j = -before … ahead

A stage that responds to the rate of its own input has no stable causal inverse of the form of eq. 8; a few
passes with a look-ahead approximate the inverse as closely as needed (iterative learning control, Arimoto
1984, run ahead of time on a model instead of from trial to trial on the stage). Everything is identified
from recordings; without passes it is the paper's compensator.
"""

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn

from torchpi.control.direct_inverse import DirectInverse
from torchpi.control.step import CompensatorStream
from torchpi.control.step_guard import GuardedStep
from torchpi.errors import ConfigError
from torchpi.operators.motion import Motion, backward_motion
from torchpi.operators.reference_filter import ReferenceFilter


class CorrectedInverse(nn.Module):
    """A direct inverse, and passes of correction by a forward model.

    Args:
        start: u_0; its output limits should be wide, because those given here apply.
        model: F, the same operator identified from voltage to displacement, from samples of u up to the
            present one.
        filters: L_p of each pass, (passes, before + 1 + ahead), V/µm, from j = ahead down to j = -before:
            the newest error first, in the order the step needs.
        ahead: How many samples a filter looks ahead.
        min_voltage_v: Lower output limit.
        max_voltage_v: Upper output limit.

    Raises:
        ConfigError: Filters of another shape, sample periods that differ, or limits out of order.
    """

    def __init__(
        self,
        start: DirectInverse,
        model: DirectInverse,
        filters: Tensor,
        ahead: int,
        min_voltage_v: float,
        max_voltage_v: float,
    ) -> None:
        super().__init__()
        if filters.ndim != 2 or filters.shape[1] < ahead + 1:
            raise ConfigError(
                f"filters: found shape {tuple(filters.shape)}, expected (passes, {ahead + 1} or more taps)"
            )
        if start.sample_period_s != model.sample_period_s:
            raise ConfigError(
                f"model: sample period {model.sample_period_s} s, expected that of start, "
                f"{start.sample_period_s} s"
            )
        if not min_voltage_v < max_voltage_v:
            raise ConfigError(
                f"min_voltage_v: found {min_voltage_v} V, expected less than max_voltage_v, {max_voltage_v} V"
            )
        self.inverse = start
        self.model = model
        self.filters = nn.Parameter(filters.detach().clone().to(torch.float64))
        self.ahead = ahead
        self.sample_period_s = start.sample_period_s
        self.preview = start.preview + len(filters) * ahead
        self.min_voltage_v = min_voltage_v
        self.max_voltage_v = max_voltage_v

    def forward(self, motion: Motion) -> Tensor:
        """Return the voltage for a desired motion from the de-energised state, within the output limits.

        Shapes: (batch, time) in µm, µm/s, µm/s² to (batch, time) in V. Sample t of the motion is the one
        `preview` periods ahead of sample t of the voltage.
        """
        v, _ = self.passes(motion, len(self.filters))
        return v.clamp(self.min_voltage_v, self.max_voltage_v)

    def passes(self, motion: Motion, count: int) -> tuple[Tensor, Tensor]:
        """Return u_p after `count` passes and its error e_p, both delayed by the look-ahead used so far."""
        v, _ = self.inverse.voltage(motion)
        late = self.inverse.preview
        e = self.miss(motion.yd, v, late)
        for taps in self.filters[:count]:
            corrected = delayed(v, self.ahead)
            for i, tap in enumerate(taps):
                corrected = corrected + tap * delayed(e, i)
            v = corrected
            late += self.ahead
            e = self.miss(motion.yd, v, late)
        return v, e

    def miss(
        self,
        yd: Tensor,  # (batch, time), µm
        v: Tensor,  # (batch, time), V
        late: int,
    ) -> Tensor:  # (batch, time), µm
        """Return e = y_d - F[u], where y_d is `late` samples old when its voltage is output."""
        answer, _ = self.model.voltage(backward_motion(v, self.sample_period_s))
        return delayed(yd, late) - answer

    def stream(self, reference_filter: ReferenceFilter | None = None) -> CompensatorStream:
        """Return the compensator as a scriptable stream with the interface of every compensator."""
        return CorrectedStream(self, reference_filter)


class CorrectedStream(GuardedStep):
    """The corrected inverse, one sample at a time."""

    def __init__(self, compensator: CorrectedInverse, reference_filter: ReferenceFilter | None) -> None:
        inverse = compensator.inverse.step_limits()
        super().__init__(
            replace(inverse, min_voltage_v=compensator.min_voltage_v, max_voltage_v=compensator.max_voltage_v)
        )
        self.sample_period_s = compensator.sample_period_s
        self.preview = compensator.preview
        self.has_reference_filter = reference_filter is not None
        self.reference = Reference(compensator.sample_period_s, reference_filter)
        self.inverse: Any = compensator.inverse.stream()
        lates = [compensator.inverse.preview + p * compensator.ahead for p in range(len(compensator.filters))]
        self.passes: Any = nn.ModuleList(
            [
                PassStream(compensator.model.stream(), taps.tolist(), compensator.ahead, late)
                for taps, late in zip(compensator.filters, lates, strict=True)
            ]
        )

    @torch.jit.export
    def reset(self) -> None:
        self.reset_guard()
        self.reference.reset()
        self.inverse.reset()
        for one in self.passes:
            one.reset()

    @torch.jit.export
    def step(self, yd: float) -> float:
        self.accept(yd)
        x = self.reference.step(self.last_input)
        v: float = self.inverse.step(x)
        for one in self.passes:
            v = one.step(x, v)
        self.emit(v)
        return self.last_voltage

    def at_rest(self, yd: float) -> float:
        self.reference.reset_at(yd)
        v: float = self.inverse.reset_at(yd)
        for one in self.passes:
            v = one.reset_at(yd, v)
        return v


class PassStream(nn.Module):
    """One pass: the model answers the voltage, and its errors, seen ahead, correct it."""

    taps: list[float]

    def __init__(self, model: CompensatorStream, taps: list[float], ahead: int, late: int) -> None:
        super().__init__()
        self.model: Any = model
        self.taps = taps  # V/um
        self.desired = Line(late)
        self.voltage = Line(ahead)
        self.errors = Line(len(taps) - 1)

    @torch.jit.export
    def reset(self) -> None:
        self.model.reset()
        self.desired.reset()
        self.voltage.reset()
        self.errors.reset()

    @torch.jit.export
    def reset_at(self, yd: float, v: float) -> float:
        """Set the state as after a long rest at yd under v; return the corrected voltage."""
        answer: float = self.model.reset_at(v)
        self.desired.reset_at(yd)
        self.voltage.reset_at(v)
        self.errors.reset_at(yd - answer)
        corrected = v
        for i in range(len(self.taps)):
            corrected = corrected + self.taps[i] * (yd - answer)
        return corrected

    @torch.jit.export
    def step(self, yd: float, v: float) -> float:
        answer: float = self.model.step(v)
        self.errors.step(self.desired.step(yd) - answer)
        corrected = self.voltage.step(v)
        for i in range(len(self.taps)):
            corrected = corrected + self.taps[i] * self.errors.past(i)
        return corrected


class Line(nn.Module):
    """The last samples of a signal, zero before the first; `step` returns the oldest, `samples` ago."""

    kept: list[float]

    def __init__(self, samples: int) -> None:
        super().__init__()
        self.kept = [0.0] * (samples + 1)
        self.newest = 0

    @torch.jit.export
    def reset(self) -> None:
        for i in range(len(self.kept)):
            self.kept[i] = 0.0

    @torch.jit.export
    def reset_at(self, x: float) -> None:
        for i in range(len(self.kept)):
            self.kept[i] = x

    @torch.jit.export
    def step(self, x: float) -> float:
        self.newest = (self.newest + 1) % len(self.kept)
        self.kept[self.newest] = x
        return self.past(len(self.kept) - 1)

    @torch.jit.export
    def past(self, samples: int) -> float:
        """Return the sample that came so many samples before the newest."""
        return self.kept[(self.newest + len(self.kept) - samples) % len(self.kept)]


class Reference(nn.Module):
    """y_r to y_d: the filter of eq. 14, or nothing."""

    def __init__(self, sample_period_s: float, reference_filter: ReferenceFilter | None) -> None:
        super().__init__()
        self.filters = reference_filter is not None
        self.filter = (reference_filter or ReferenceFilter(sample_period_s)).stream()

    @torch.jit.export
    def reset(self) -> None:
        self.filter.reset()

    @torch.jit.export
    def reset_at(self, y: float) -> None:
        if self.filters:
            self.filter.reset_at(y)

    @torch.jit.export
    def step(self, y: float) -> float:
        if self.filters:
            y, _, _ = self.filter.step(y)
        return y


def delayed(x: Tensor, samples: int) -> Tensor:
    """Return x delayed by a number of samples, zero before its first. Shape: (batch, time)."""
    if samples == 0:
        return x
    return nn.functional.pad(x, (samples, 0))[:, : x.shape[1]]
