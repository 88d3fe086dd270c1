"""What the input of a block does between samples depends on the blocks before it."""

from collections.abc import Sequence

from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.effect import Effect


def hold_first_block(effects: Sequence[Effect], held: bool) -> None:
    """Tell the first dynamic block of a chain that its input is held through each sample, if it is.

    Behind it, and behind an amplifier that is slow itself, a signal runs straight from sample to sample. A
    delay behind the amplifier's lag takes the exponential from it.
    """
    lag = next((effect for effect in effects if isinstance(effect, AmplifierLag)), None)
    for effect in effects:
        if isinstance(effect, Delay):
            effect.decay = None if lag is None or lag.is_ideal() or lag.poles() > 1 else lag.decay
    for effect in effects:
        if effect.smooths:
            return
        if effect.hold is not None:
            effect.hold = "end" if held else "first"
            return
