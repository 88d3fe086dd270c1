"""A further mode in parallel with the stiff path: y = (1 - s) x + s M(x), M a mode of unit static gain."""

from typing import ClassVar

from torch import nn

from torchpi.operators.linear import Matrices
from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import DataRange, Parameters
from torchpi.stage.effects.mechanics.resonance import OF_A_MODE, Resonance


class SecondMode(Resonance):
    """A mode with a share s of the static gain; the rest goes straight through.

    Modal superposition: Preumont, *Vibration Control of Active Structures*, ch. 2. A negative share is a
    mode whose shape has opposite signs at the sensor and at the actuator.
    """

    name = "second_mode"
    equation = "y = (1 - s) x + s M(x)"
    signature = "rings at one frequency, weakly: a resonance next to an antiresonance"
    left_by = ("resonance",)
    quantities: ClassVar[dict[str, Quantity]] = {
        "share": Quantity("", at_least=-0.9, at_most=0.9),
        **OF_A_MODE,
    }
    forms: ClassVar[tuple[str, ...]] = ()
    alike_inside = ("resonance",)  # in place of another
    share: nn.Parameter

    def matrices(self) -> Matrices:
        a, b, c, d = super().matrices()
        return a, b, self.share * c, (1 - self.share) + self.share * d

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        # Half as many as for a resonance: the residual shows the frequency of a faint mode.
        return super().starts(seen)[::2]

    @classmethod
    def starts_at(cls, seen: DataRange, frequencies_hz: list[float]) -> list[Parameters]:
        return [{"share": 0.05, **start} for start in super().starts_at(seen, frequencies_hz)]
