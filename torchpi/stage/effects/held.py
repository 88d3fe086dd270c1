"""How each block's input behaves between samples, which depends on the blocks before it."""

from collections.abc import Sequence
from typing import NamedTuple

from torchpi.operators.linear import Hold
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.effect import Effect


class BetweenSamples(NamedTuple):
    """How the input of one effect behaves between samples."""

    hold: Hold | None
    """None if the effect does not depend on it."""
    lag: AmplifierLag | None
    """For a delay: the amplifier's lag of one pole, if its input is exponential behind that."""

    def set_on(self, effect: Effect) -> None:
        if isinstance(effect, Delay):
            effect.decay = None if self.lag is None else self.lag.decay
        if self.hold is not None:
            effect.hold = self.hold


def between_samples(effects: Sequence[Effect], held: bool) -> list[BetweenSamples]:
    """Return how the input of every effect of a chain behaves between samples.

    If the command is held during each sample, so is the input of the first dynamic block. Behind that block,
    and behind an amplifier with a lag or slew limit, a signal is linear between samples. A delay behind an
    amplifier's lag of one pole uses the exponential of that lag.
    """
    lag = next((effect for effect in effects if isinstance(effect, AmplifierLag)), None)
    if lag is not None and (lag.is_ideal() or lag.poles() > 1):
        lag = None
    found = []
    for effect in effects:
        hold: Hold | None = None if effect.hold is None else "end" if held else "first"
        found.append(BetweenSamples(hold, lag if isinstance(effect, Delay) else None))
        held = held and not effect.smooths and effect.hold is None
    return found


def hold_first_block(effects: Sequence[Effect], held: bool) -> None:
    """Set, for every effect of a chain that needs it, how its input behaves between samples.

    Every effect is set anew, whatever another chain has set before.
    """
    for effect, one in zip(effects, between_samples(effects, held), strict=True):
        one.set_on(effect)
