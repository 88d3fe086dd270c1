"""The rate-dependent operator whose thresholds grow with the rate, and its inverse.

    y(t) = Σ_i w_i H_ri(t)[u](t),   r_i(t) = r_i + ρ_i |u̇(t)|,  r_0 = ρ_0 = 0
    u(t) = Σ_i w'_i H_r'i(t)[y](t),   r'_i(t), w'_i by the closed form from r_i(t), w_i at every t

Al Janaideh and Krejčí, *An inversion formula for a Prandtl–Ishlinskii operator with time dependent
thresholds*, Physica B 406(8), 2011, and *Inverse rate-dependent Prandtl–Ishlinskii model for feedforward
compensation of hysteresis in a piezomicropositioning actuator*, IEEE/ASME Trans. Mechatronics 18(5), 2013.

The formula is exact, sample by sample, under the dilation condition: no distance r_(i+1)(t) - r_i(t) between
plays, i ≥ 1, shrinks in time (the first threshold itself may). A play with the larger threshold is then a
play of the next smaller one's output, which is all that the closed form needs.

The condition is sufficient, not necessary. If ρ grows with i, it fails whenever the rate falls. But these
thresholds are smallest at each reversal of their own input: between two reversals a play that is pushed stays
pushed while its threshold falls, and no two plays move further apart than their thresholds. The formula thus
still holds, except for the effect of sampling a reversal. It does need thresholds that are known functions of
time. A compensator has to form them from ẏ_d where the model has u̇, which is its error.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from torchpi.control.indirect.base import IndirectInverse
from torchpi.errors import ConfigError
from torchpi.operators.base import Operator, StepStream
from torchpi.operators.generalised_play import clamp_bank, clamp_play
from torchpi.operators.motion import Motion
from torchpi.operators.rate_dependent_pi import RATE_STATES, own_rate, own_rate_step
from torchpi.operators.weighted_sum import weighted_sum

ROUNDING = 1e-12  # of the largest threshold: a distance that shrinks by less counts as constant


@dataclass(frozen=True)
class Dilation:
    """Whether thresholds meet the condition under which the inversion formula is exact, and where not."""

    holds: bool
    samples: int
    violations: int  # samples at which some distance is smaller than one sample before
    first_sample: int | None
    largest_shrinkage: float  # of a distance within one sample, unit of the thresholds
    plays: tuple[int, int] | None  # the pair whose distance shrinks most

    def __str__(self) -> str:
        if self.holds:
            return f"the dilation condition holds over all {self.samples} samples"
        assert self.plays is not None
        return (
            f"the dilation condition fails at {self.violations} of {self.samples} samples, first at "
            f"{self.first_sample}; plays {self.plays[0]} and {self.plays[1]} come closer by up to "
            f"{self.largest_shrinkage:.3g} in one sample: the inverse need not be exact there"
        )


def dilation(
    r: Tensor,  # (time, plays), any unit, thresholds in the order of the plays
) -> Dilation:
    """Check whether the dilation condition holds, and where it fails.

    Raises:
        ConfigError: Thresholds that are out of order or not finite, so that there is nothing to check.

    Example:
        >>> import torch
        >>> from torchpi.control.indirect import dilation
        >>> r = torch.tensor([[0.0, 1.0, 2.0], [0.0, 1.0, 1.75]], dtype=torch.float64)
        >>> found = dilation(r)
        >>> (found.holds, found.plays, found.largest_shrinkage)
        (False, (1, 2), 0.25)
    """
    if r.ndim != 2 or not bool(torch.isfinite(r).all()) or bool((r.diff(dim=1) < 0).any()):
        raise ConfigError(
            f"r: found shape {tuple(r.shape)}, expected finite (time, plays) in increasing order"
        )
    # The play with the first threshold does not act on another play's output: its threshold may shrink.
    shrinkage = -r[:, 1:].diff(dim=1).diff(dim=0) if r[0, 0] == 0 else -r.diff(dim=1).diff(dim=0)
    first_play = 1 if r[0, 0] == 0 else 0
    if shrinkage.numel() == 0:
        return Dilation(True, len(r), 0, None, 0.0, None)
    shrinks = (shrinkage > ROUNDING * r.abs().max()).any(1)
    if not bool(shrinks.any()):
        return Dilation(True, len(r), 0, None, 0.0, None)
    at, pair = divmod(int(shrinkage.argmax()), shrinkage.shape[1])
    return Dilation(
        holds=False,
        samples=len(r),
        violations=int(shrinks.sum()),
        first_sample=int(shrinks.nonzero()[0]) + 1,
        largest_shrinkage=float(shrinkage[at, pair]),
        plays=(first_play + pair, first_play + pair + 1),
    )


def moving_step(x: float, n: list[float], s: list[float]) -> float:
    """One step of the forward operator in the form a stream calls: n holds T, r, ρ and w; s the state."""
    size = abs(own_rate_step(x, n[0], s))
    plays, total = len(s) - 3, 0.0
    for i in range(plays):
        r = n[1 + i] + n[1 + plays + i] * size
        s[i] = clamp_play(x - r, x + r, s[i])
        total += n[1 + 2 * plays + i] * s[i]
    return total


class TimeVaryingThresholdPI(Operator):
    """The forward operator; the rate is that of its own input, by the three-point backward difference.

    The state consists of the plays, then the memory of the rate.

    Args:
        sample_period_s: T.
        thresholds: r at rest, unit of the input, rising from 0.
        weights: w, one per threshold.
        threshold_slopes: ρ, growth with the rate's magnitude; 0 first, none below the one before.

    Raises:
        ConfigError: As for `TimeVaryingThresholdInverse`: an operator without inverse is refused.
    """

    def __init__(
        self,
        sample_period_s: float,
        thresholds: Sequence[float],
        weights: Sequence[float],
        threshold_slopes: Sequence[float],
    ) -> None:
        super().__init__()
        TimeVaryingThresholdInverse(sample_period_s, thresholds, weights, threshold_slopes=threshold_slopes)
        self.sample_period_s = sample_period_s
        self.r: Tensor
        self.register_buffer("r", torch.tensor(list(thresholds), dtype=torch.float64))
        self.rho: Tensor
        self.register_buffer("rho", torch.tensor(list(threshold_slopes), dtype=torch.float64))
        self.w = nn.Parameter(torch.tensor(list(weights), dtype=torch.float64))

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, len(self.r) + RATE_STATES, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time)
        state: Tensor | None = None,  # (batch, plays + rate memory)
    ) -> tuple[Tensor, Tensor]:
        state = self.initial_state(len(x)).to(x.device, x.dtype) if state is None else state
        h0, memory = state.split([len(self.r), RATE_STATES], 1)
        rate, memory = own_rate(x, memory, self.sample_period_s)
        y, h0 = self.at_thresholds(x, self.thresholds(rate), h0)
        return y, torch.cat([h0, memory], 1)

    def thresholds(
        self,
        rate: Tensor,  # (batch, time), unit of the input per s
    ) -> Tensor:  # (batch, time, plays)
        """Return r_i + ρ_i |rate|."""
        return self.r + self.rho * rate.abs()[..., None]

    def at_thresholds(
        self,
        x: Tensor,  # (batch, time), any unit
        r: Tensor,  # (batch, time, plays), the unit of x
        state: Tensor | None = None,  # (batch, plays), the unit of x
    ) -> tuple[Tensor, Tensor]:
        """Apply the operator with thresholds that are known functions of time."""
        h0 = torch.zeros(len(x), len(self.r), dtype=x.dtype) if state is None else state
        h = clamp_bank(x[..., None] - r, x[..., None] + r, h0)
        return weighted_sum(h, torch.ones_like(x)[..., None], self.w.to(x.dtype)[:, None]), h[:, -1]

    def stream(self) -> StepStream:
        numbers = torch.cat([self.r, self.rho, self.w]).tolist()
        return StepStream(moving_step, [self.sample_period_s, *numbers], len(self.r) + RATE_STATES)


class TimeVaryingThresholdInverse(IndirectInverse):
    """The inversion formula, its thresholds formed from ẏ_d; exact where both rates agree and dilate."""

    def dilation(self, motion: Motion) -> Dilation:
        """Check the condition for the thresholds of this motion; return the worst row of a batch."""
        rate = motion.yd_dot.detach().abs()[..., None]
        r = torch.tensor(self.r, dtype=torch.float64) + torch.tensor(self.rho, dtype=torch.float64) * rate
        return max((dilation(row) for row in r), key=lambda report: report.violations)

    def at_thresholds(
        self,
        y: Tensor,  # (batch, time), µm
        r: Tensor,  # (batch, time, plays), V, of the forward operator
    ) -> Tensor:  # (batch, time), V
        """Apply the inversion formula with thresholds that are known functions of time, from zero states."""
        slopes = torch.tensor(self.b, dtype=torch.float64).cumsum(0)[:-1]
        inverse = torch.cat([torch.zeros_like(r[..., :1]), (slopes * r.diff(dim=-1)).cumsum(-1)], -1)
        h = clamp_bank(y[..., None] - inverse, y[..., None] + inverse, torch.zeros(len(y), len(self.b)).to(y))
        w = torch.tensor(self.inverse_weights, dtype=torch.float64)[:, None]
        return weighted_sum(h, torch.ones_like(y)[..., None], w)
