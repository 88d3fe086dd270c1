"""The direct inverse with generalised plays: different envelopes and thresholds up and down.

    u = Σ_i (k_i ẏ_d + b_i) h_i[y_d]     (eq. 8, with h of `operators.generalised_play` for H_r[S])

It is direct, not indirect: fitted from displacement to voltage and never inverted. Qin et al. (2013), Section
II-A, name these plays as a way to model more complex loops; Al Janaideh, Rakheja and Su (2009) give the
forward model, whose inverse in closed form needs equal envelopes up and down, unlike this one.
"""

from typing import Any, cast

import torch
from torch import Tensor, nn

from torchpi.control.indirect.deployed import Deployed, Inverse
from torchpi.control.step import CompensatorStream
from torchpi.errors import ConfigError
from torchpi.operators.generalised_play import GeneralisedPlayBank
from torchpi.operators.motion import Motion
from torchpi.operators.reference_filter import ReferenceFilter
from torchpi.operators.weighted_sum import weight, weighted_sum


class GeneralisedDirectInverse(Inverse):
    """Maps a desired motion to the voltage that produces it, through generalised plays; trainable.

    Args:
        sample_period_s: T of the control loop and of the recordings.
        plays: The bank over y_d, µm.
        slopes: k, one per play.
        offsets: b, one per play.
        preview: How many samples ahead the desired trajectory is seen.
        min_voltage_v: Lower output limit; -inf for none.
        max_voltage_v: Upper output limit; inf for none.

    Raises:
        ConfigError: Not as many slopes or offsets as plays, or a value out of its range.
    """

    def __init__(
        self,
        sample_period_s: float,
        plays: GeneralisedPlayBank,
        slopes: list[float],
        offsets: list[float],
        preview: int = 0,
        min_voltage_v: float = 0.0,
        max_voltage_v: float = 10.0,
    ) -> None:
        super().__init__(sample_period_s, preview, min_voltage_v, max_voltage_v)
        count = len(plays.raw_up)
        for name, values in (("slopes", slopes), ("offsets", offsets)):
            if len(values) != count:
                raise ConfigError(f"{name}: found {len(values)}, expected {count}, one per play")
        self.plays = plays
        self.b = nn.Parameter(torch.tensor(offsets, dtype=torch.float64))
        self.k = nn.Parameter(torch.tensor(slopes, dtype=torch.float64))

    def voltage(
        self,
        motion: Motion,
        state: Tensor | None = None,  # (batch, plays)
    ) -> tuple[Tensor, Tensor]:
        """Return the voltage before the output limits, and the state after it."""
        h, state = self.plays(motion.yd, state)
        basis = torch.stack([torch.ones_like(motion.yd_dot), motion.yd_dot], -1)
        return weighted_sum(h, basis, torch.stack([self.b, self.k], 1)), state

    def stream(self, reference_filter: ReferenceFilter | None = None) -> CompensatorStream:
        """Return a scriptable stream, `u = step(y_d at t + preview)`, with the same bits as `forward`."""
        law = WeightedPlaysStream(self.plays.stream(), self.b, self.k)
        return cast(CompensatorStream, Deployed(law, self, reference_filter))


class WeightedPlaysStream(nn.Module):
    """Σ_i (b_i + k_i ẋ) h_i over any bank of plays, one sample at a time, at a rate that is given.

    Args:
        plays: Stream of the bank, whose `step(x)` returns the list of its states.
        b: Weights at rest, one per play.
        k: Change of the weights with the rate.
    """

    theta: list[float]
    basis: list[float]

    def __init__(self, plays: Any, b: Tensor, k: Tensor) -> None:
        super().__init__()
        self.plays = plays
        self.theta = torch.stack([b, k], 1).flatten().tolist()
        self.basis = [1.0, 0.0]

    @torch.jit.export
    def reset(self) -> None:
        self.plays.reset()

    @torch.jit.export
    def step(self, x: float, rate: float, acceleration: float) -> float:
        self.basis[1] = rate
        h: list[float] = self.plays.step(x)
        total = 0.0
        for i in range(len(h)):
            total += weight(self.theta, self.basis, i) * h[i]
        return total
