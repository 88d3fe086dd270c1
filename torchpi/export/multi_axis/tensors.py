"""Several axes as TorchScript: a step on tensors whose results equal those of the kernels to the last bit.

Every sum runs in the order of the kernels: `cumsum` adds term by term, and filters have the transposed form.
"""

import warnings
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from torchpi.control.multi_axis import MultiAxisInverse
from torchpi.operators.modal_feedback import DIVERGED, SMALLEST_MEAN
from torchpi.operators.oversampled_inputs import FACTOR, low_pass_taps, taps_by_phase
from torchpi.stage.multi_axis import MultiAxisStage


def scripted(exported: MultiAxisStage | MultiAxisInverse) -> torch.jit.ScriptModule:
    """Return the compiled step in its rest state."""
    module = StageStep(exported) if isinstance(exported, MultiAxisStage) else InverseStep(exported)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
        return cast(torch.jit.ScriptModule, torch.jit.script(module.eval()))


def in_order(terms: Tensor, dim: int) -> Tensor:
    """Sum the terms in order, from the first to the last."""
    return terms.cumsum(dim).select(dim, -1)


def tensor(array: np.ndarray) -> Tensor:
    """Copy an array into a tensor with its own memory."""
    return torch.from_numpy(np.array(array, order="C"))


def root(x: Tensor) -> Tensor:
    """Return √x to the last bit; MKL's real root, which torch may call, errs by one in some of a hundred."""
    return x.to(torch.complex128).sqrt().real


def exact(numbers: list[float]) -> Tensor:
    """Return a float64 tensor of the numbers; in TorchScript `torch.tensor` rounds to single precision."""
    found = torch.empty(len(numbers), dtype=torch.float64)
    for i, number in enumerate(numbers):
        found[i].fill_(number)
    return found


class StageTensors(nn.Module):
    """A stage of several axes from sample to sample, late by its look-ahead."""

    def __init__(self, stage: MultiAxisStage) -> None:
        super().__init__()
        arrays, inputs = stage.arrays(), stage.input_stream()
        zones, thresholds, kept, shares = stage.thresholds_of_kernel()
        interpolation, decimation = taps_by_phase()
        own_input = np.arange(stage.shapes.elements) % stage.inputs
        self.poles, self.drive, self.force = (tensor(arrays[name]) for name in ("poles", "drive", "force"))
        self.sensed, self.through = tensor(arrays["sensed"]), tensor(arrays["through"])
        self.weights, self.play_weights = tensor(arrays["weights"]), tensor(arrays["play_weights"])
        self.seen, self.direct = tensor(arrays["seen"]), tensor(arrays["direct"])
        self.ahead = tensor(arrays["ahead"].transpose(0, 2, 1))  # (outputs, ahead, inputs)
        self.offset, self.own_input = tensor(stage.offset()), tensor(own_input)
        self.interpolation = tensor(interpolation.reshape(-1, FACTOR, 1))
        self.low_pass = tensor(decimation[..., None])
        self.input_r, self.input_kept = tensor(inputs.thresholds), tensor(inputs.kept)
        self.widths, self.high_pass = tensor(inputs.widths), tensor(inputs.high_pass)
        self.zones, self.above = tensor(zones), tensor(zones[None] >= 0)
        self.r, self.kept, self.shares = tensor(thresholds), tensor(kept), tensor(shares)
        self.newest, self.omega = float(low_pass_taps()[0]), inputs.omega
        self.inputs, self.outputs, self.delay = stage.inputs, stage.outputs, stage.delay_samples
        self.smallest_mean, self.diverged = SMALLEST_MEAN, DIVERGED
        self.unbounded = 0
        self.begin()

    def begin(self) -> None:
        """The state at rest."""
        m, elements = self.inputs, self.weights.shape[0]
        self.up = torch.zeros_like(self.interpolation.expand(-1, -1, m))
        self.low = torch.zeros(self.low_pass.shape[1] + 1, m, dtype=torch.float64)
        self.late = torch.zeros(self.delay, m, dtype=torch.float64)
        self.input_plays = torch.zeros(m, len(self.input_r), dtype=torch.float64)
        self.slope = torch.zeros(m, 1, dtype=torch.float64)
        self.lost = torch.zeros(m, 2 * len(self.widths), dtype=torch.float64)
        self.h = torch.zeros(elements, len(self.r), dtype=torch.float64)
        self.means = torch.zeros(elements, len(self.shares), dtype=torch.float64)
        self.x = torch.zeros_like(self.poles)
        self.past = 0
        self.to_come = self.delay
        self.at = 0

    def added(self, u: Tensor) -> Tensor:
        """Return the contribution of plays and amplifiers to the voltages, V, (inputs,)."""
        rest = torch.zeros_like(self.up[:1])
        self.up = torch.cat([self.up[1:], rest]) + self.interpolation * u
        between = torch.jit.annotate(list[Tensor], [])
        for q in range(self.interpolation.shape[1]):
            x = self.up[0, q].unsqueeze(1)
            self.input_plays = relaxed(x, self.input_r, self.input_kept, self.input_plays)
            parts = [self.input_plays - x]
            if len(self.widths) > 0:
                fast = self.high_pass[0] * x + self.slope
                self.slope = self.high_pass[1] * x - self.high_pass[2] * fast
                s = self.omega * fast / self.widths
                odd = s / root(1.0 + s * s)
                crossed = torch.cat([odd, odd * odd], 1)
                e = self.high_pass[0] * crossed + self.lost
                self.lost = self.high_pass[1] * crossed - self.high_pass[2] * e
                parts.append(e)
            terms = self.play_weights * torch.cat(parts, 1)
            between.append(in_order(terms, 1) if terms.shape[1] > 0 else torch.zeros_like(u))
        found: Tensor = self.low[0] + self.newest * between[0]
        low = self.low[1:]
        for q in range(len(between)):
            low = low + self.low_pass[q] * between[q]
        self.low = torch.cat([low, torch.zeros_like(self.low[:1])])
        return found

    def advance(self, u: Tensor) -> Tensor:
        """Return displacements, (outputs,), µm, for voltages, (inputs,), V."""
        v = self.late[self.at] + self.added(u)
        self.late[self.at] = u
        self.at = (self.at + 1) % self.delay
        if self.to_come > 0:
            self.to_come -= 1
            return self.offset.clone()
        x = self.x
        drive = self.drive * v
        if self.weights.shape[0] > 0:
            of_modes = self.sensed[:, :, 0] * x[:, 0] + self.sensed[:, :, 1] * x[:, 1]
            z = in_order(torch.cat([of_modes, self.through * v], 1), 1).unsqueeze(1)
            if not bool((z.abs() < self.diverged).all()):
                self.begin()
                self.unbounded += 1
                return self.offset.clone()
            e = z - self.zones
            nothing = torch.zeros_like(e)
            self.h = relaxed(z, self.r, self.kept, self.h)
            self.past += 1
            share = torch.clamp(self.shares, min=1.0 / self.past)
            self.means = self.means + share * (z.abs() - self.means)
            phi = torch.cat(
                [
                    torch.where(self.above, torch.maximum(e, nothing), torch.minimum(e, nothing)),
                    self.h - z,
                    z * root(self.means + self.smallest_mean),
                    z * v.index_select(0, self.own_input).unsqueeze(1),
                ],
                1,
            )
            w = in_order(self.weights * phi, 1)
            drive = torch.cat([drive, self.force * w], 2)
        of_modes = self.seen[:, :, 0] * x[:, 0] + self.seen[:, :, 1] * x[:, 1]
        y = in_order(torch.cat([of_modes, self.direct * v], 1), 1) + self.offset
        taps = self.ahead.shape[1]
        if taps > 0:
            to_come = torch.cat([self.late[self.at :], self.late[: self.at]])[:taps]
            y = y + in_order((self.ahead * to_come).flatten(1), 1)
        re, im = self.poles[:, 0], self.poles[:, 1]
        f = in_order(drive, 2)
        first = re * x[:, 0] - im * x[:, 1] + f[:, 0]
        self.x = torch.stack([first, im * x[:, 0] + re * x[:, 1] + f[:, 1]], 1)
        return y


def relaxed(x: Tensor, r: Tensor, a: Tensor, h: Tensor) -> Tensor:
    """Apply `relaxing_play` to tensors."""
    e = x - h
    s = e / r
    return x - a * e / root(1.0 + (1.0 - a * a) * s * s)


class FilterTensors(nn.Module):
    """`filter_matrix` from sample to sample, transposed."""

    def __init__(self, taps: np.ndarray) -> None:
        super().__init__()
        self.taps = tensor(taps.transpose(2, 0, 1))
        self.begin()

    def begin(self) -> None:
        """The state at rest."""
        self.sums = torch.zeros_like(self.taps[0])

    def advance(self, x: Tensor) -> Tensor:
        """Return the filtered sample, (outputs,), for one sample, (inputs,)."""
        sums = torch.cat([self.sums[1:], torch.zeros_like(self.sums[:1])])
        for o in range(len(x)):
            sums = sums + self.taps[o] * x[o]
        self.sums = sums
        return sums[0]


class PassTensors(nn.Module):
    """A correction of voltages against the stage."""

    def __init__(self, inverse: MultiAxisInverse) -> None:
        super().__init__()
        self.stage, self.filter = StageTensors(inverse.stage), FilterTensors(inverse.corrections)
        self.wait = inverse.half + inverse.stage.delay_samples
        self.begin()

    def begin(self) -> None:
        """The state at rest."""
        self.stage.begin()
        self.filter.begin()
        self.desired = torch.zeros(self.wait, self.stage.outputs, dtype=torch.float64)
        self.voltages = torch.zeros(self.wait, self.stage.inputs, dtype=torch.float64)
        self.at = 0

    def advance(self, yd: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """Return the delayed trajectory and the corrected, delayed voltages."""
        late, before = self.desired[self.at].clone(), self.voltages[self.at].clone()
        self.desired[self.at], self.voltages[self.at] = yd, u
        self.at = (self.at + 1) % self.wait
        lacking = late - (self.stage.advance(u) - self.stage.offset)
        return late, before + self.filter.advance(lacking)


class Step(nn.Module):
    """A step of tensors, `forward`, as a loop calls it: with lists of numbers, and in blocks."""

    def __init__(self, sample_rate_hz: float, takes: int, gives: int) -> None:
        super().__init__()
        self.sample_period_s = 1 / sample_rate_hz
        self.gives = gives
        self.held_inputs = 0
        self.accepted = torch.zeros(takes, dtype=torch.float64)

    @torch.jit.export
    def step(self, x: list[float]) -> list[float]:
        # Assigned to a name, because TorchScript evaluates the expression before `tolist` three times.
        y: Tensor = self.forward(exact(x))
        numbers: list[float] = y.tolist()
        return numbers

    @torch.jit.export
    def block(self, x: Tensor) -> Tensor:
        """Apply the step to a block, from (time, inputs) to (time, outputs)."""
        y = torch.empty(len(x), self.gives, dtype=torch.float64)
        for t in range(len(x)):
            y[t] = self.forward(x[t])
        return y


class StageStep(Step):
    """`step` from voltages to displacements, `delay_samples` late."""

    def __init__(self, stage: MultiAxisStage) -> None:
        super().__init__(stage.sample_rate_hz, stage.inputs, stage.outputs)
        self.stage = StageTensors(stage)
        self.delay_samples = stage.delay_samples
        self.inputs, self.outputs = stage.inputs, stage.outputs

    @torch.jit.export
    def reset(self) -> None:
        """To rest."""
        self.stage.begin()
        self.stage.unbounded = 0
        self.accepted = torch.zeros_like(self.accepted)
        self.held_inputs = 0

    def forward(self, u: Tensor) -> Tensor:
        """Step one sample, from (inputs,), V, to (outputs,), µm."""
        if bool(torch.isfinite(u).all()):
            self.accepted = u
        else:
            self.held_inputs += 1
        return self.stage.advance(self.accepted)


class InverseStep(Step):
    """`step` from desired displacements, `preview` samples ahead, to voltages."""

    def __init__(self, inverse: MultiAxisInverse) -> None:
        stage = inverse.stage
        super().__init__(stage.sample_rate_hz, stage.outputs, stage.inputs)
        self.first = FilterTensors(inverse.first)
        self.passes = nn.ModuleList([PassTensors(inverse) for _ in range(inverse.passes)])
        self.limits_v, self.accepted_um = tensor(inverse.limits_v), tensor(inverse.accepted_um)
        self.preview = inverse.preview
        self.inputs, self.outputs = stage.inputs, stage.outputs
        self.limited_outputs = 0

    @torch.jit.export
    def reset(self) -> None:
        """To rest."""
        self.first.begin()
        for one in self.passes:
            one.begin()  # type: ignore[operator]
        self.accepted = torch.zeros_like(self.accepted)
        self.held_inputs = 0
        self.limited_outputs = 0

    def forward(self, yd: Tensor) -> Tensor:
        """Step one sample, from (outputs,), µm, to (inputs,), V."""
        # A comparison with NaN is false, so NaN is held as well.
        if bool((yd.abs() <= self.accepted_um).all()):
            self.accepted = yd
        else:
            self.held_inputs += 1
        desired = self.accepted
        u = self.first.advance(desired)
        for one in self.passes:
            desired, u = one.advance(desired, u)  # type: ignore[operator]
        limited = torch.minimum(torch.maximum(u, self.limits_v[:, 0]), self.limits_v[:, 1])
        if bool((limited != u).any()):
            self.limited_outputs += 1
        return limited
