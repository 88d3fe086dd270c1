"""A spring that the actuator works against: gain k_A / (k_A + k_S), frequency √((k_A + k_S) / k_A) f₀.

Physik Instrumente, *Fundamentals of Piezo Technology*: displacement with a spring load.
"""

from torch import Tensor, nn

from torchpi.operators.base import Static
from torchpi.operators.polynomial import PolynomialStream
from torchpi.stage.effects.effect import DataRange, LinearEffect, Needs, Parameters, parameter


class LoadChange(Static, LinearEffect):
    """The static gain under a load spring of k_S = `stiffness_ratio` · k_A, another in each recording.

    It is relative to the load for which the stage's gain holds, and negative if a load was removed.
    """

    name = "load_change"
    block = "mechanics"
    equation = "y = k_A / (k_A + k_S) x"
    signature = "a different gain in another recording, and a resonance scaled by 1/√gain"
    time_scale = "static"
    left_by = ("resonance", "second_mode")
    needs = Needs(recordings=2)
    stiffness_ratio: nn.Parameter = parameter("", at_least=-0.5, at_most=10.0)
    per_recording = ("stiffness_ratio",)
    relative = True

    def gain(self) -> Tensor:
        """Return k_A / (k_A + k_S). Shape ()."""
        return 1 / (1 + self.stiffness_ratio)

    def of(self, x: Tensor) -> Tensor:
        return self.gain() * x

    def stream(self) -> nn.Module:
        return PolynomialStream([self.gain().item()])

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        return [{"stiffness_ratio": 0.1}]
