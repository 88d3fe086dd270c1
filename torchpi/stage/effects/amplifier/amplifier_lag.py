"""An output resistance that charges the stack: v̇ = 2πf_c (u - v), f_c = 1/(2πR_oC_L)."""

import math
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.operators.linear import Matrices
from torchpi.operators.quantity import CUTOFF, Quantity
from torchpi.stage.effects.effect import Parameters, Seen, StateSpaceEffect


class AmplifierLag(StateSpaceEffect):
    """A first-order lag of a voltage that a converter holds: v(k) = e^{-ωT} v(k-1) + (1 - e^{-ωT}) u(k).

    u(k) is the command held during the sample that ends at tick k.
    """

    name = "amplifier_lag"
    block = "amplifier"
    before_hysteresis = True
    equation = "v̇ = 2πf_c (u - v)"
    signature = "phase grows in proportion to frequency, the gain rolls off"
    quantities: ClassVar[dict[str, Quantity]] = {"cutoff_hz": Quantity("Hz", at_least=1.0, at_most=1e6)}
    identity: ClassVar[Parameters] = {"cutoff_hz": math.inf}
    accepted: ClassVar[dict[str, Quantity]] = {"cutoff_hz": CUTOFF}
    order = 1
    cutoff_hz: nn.Parameter

    def is_ideal(self) -> bool:
        """Whether there is no lag at all."""
        return math.isinf(self.cutoff_hz.item())

    def decay(self, samples: Tensor) -> Tensor:
        """e^{-ω · samples · T}: what is left of a voltage after that many samples."""
        return torch.exp(-2 * math.pi * self.sample_period_s * self.cutoff_hz * samples)

    def matrices(self) -> Matrices:
        # The state is what is left of the voltage a sample later.
        decay = self.decay(torch.ones_like(self.cutoff_hz))
        fresh = 1 - decay
        return decay.reshape(1), (decay * fresh).reshape(1), torch.ones_like(decay).reshape(1), fresh

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        # Above a third of the sample rate a held input shows no lag.
        return [{"cutoff_hz": f} for f in (16.0, 60.0, 200.0, 700.0, 2500.0, 9000.0) if f < seen.fs_hz / 3]
