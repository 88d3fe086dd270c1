"""Effects inside the hysteresis: they change the plays themselves, not a signal before or after them."""

from typing import ClassVar

from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import Parameters, Seen


class InsideEffect:
    """What changes the states whose weighted sum is the displacement; `Hysteresis` has the equations.

    The attributes are those of `Effect`.
    """

    name: ClassVar[str]
    block = "actuator"
    equation: ClassVar[str]
    signature: ClassVar[str]
    quantities: ClassVar[dict[str, Quantity]]
    identity: ClassVar[Parameters]
    per_recording: ClassVar[tuple[str, ...]] = ()
    before_hysteresis = True
    takes_aux = False
    jumps: ClassVar[tuple[str, ...]] = ()
    kinks: ClassVar[tuple[str, ...]] = ()
    kinds: ClassVar[tuple[str, ...]] = ()
    hold = None

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        """As of `Effect`."""
        raise TypeError(f"{cls.__name__} must define starts(seen)")
