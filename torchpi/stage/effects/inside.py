"""Effects inside the hysteresis: they change the plays themselves, not a signal before or after them."""

from typing import ClassVar

from torchpi.stage.effects.effect import Block, DataRange, Described, Parameters


class InsideEffect(Described):
    """What changes the states whose weighted sum is the displacement; `Hysteresis` has the equations."""

    block: ClassVar[Block] = "actuator"
    before_hysteresis: ClassVar[bool] = True

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        """As of `Effect`."""
        raise TypeError(f"{cls.__name__} must define starts(seen)")
