"""Third block: displacement of the ceramic to the displacement of the platform."""

from torchpi.errors import StageError
from torchpi.operators.mode import Mode
from torchpi.stage.chain import Chain


class Mechanics(Chain):
    """One lightly damped mode of unit static gain. Given nothing, rigid.

    Args:
        sample_period_s: T.
        frequency_hz: Of the mode, undamped; None is rigid.
        damping_ratio: Of the mode; stands with `frequency_hz`.

    Raises:
        StageError: An unphysical value, or one of the two without the other.
    """

    mode: Mode | None

    def __init__(
        self, sample_period_s: float, *, frequency_hz: float | None = None, damping_ratio: float | None = None
    ) -> None:
        if frequency_hz is not None and damping_ratio is not None:
            super().__init__(mode=Mode(sample_period_s, frequency_hz, damping_ratio))
        elif frequency_hz is None and damping_ratio is None:
            super().__init__(mode=None)
        else:
            missing = "frequency_hz" if frequency_hz is None else "damping_ratio"
            raise StageError(f"{missing}: found none, want a number: a mode has both")

    def settings(self) -> dict[str, object]:
        """What the constructor takes, with the present values."""
        if self.mode is None:
            return {}
        return {
            "frequency_hz": self.mode.frequency_hz.item(),
            "damping_ratio": self.mode.damping_ratio.item(),
        }
