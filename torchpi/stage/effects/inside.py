"""Effects inside the hysteresis: they change the plays themselves, not a signal before or after them."""

from typing import ClassVar

from torchpi.stage.effects.effect import Block, DataRange, Described, Parameters


class InsideEffect(Described):
    """An effect on the states whose weighted sum is the displacement; `Hysteresis` has the equations."""

    block: ClassVar[Block] = "actuator"
    before_hysteresis: ClassVar[bool] = True

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        """Return starting points of a fit, as `Effect.starts` does."""
        raise TypeError(f"{cls.__name__} must define starts(seen)")
