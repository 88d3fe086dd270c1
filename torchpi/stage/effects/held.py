"""What the input of a block does between samples depends on the blocks before it."""

from collections.abc import Sequence

from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.effect import Effect


def hold_first_block(effects: Sequence[Effect], held: bool) -> None:
    """Set, for every effect of a chain that needs it, what its input does between samples.

    If the command is held through each sample, so is the input of the first dynamic block. Behind it, and
    behind an amplifier that is slow itself, a signal runs straight from sample to sample. A delay behind an
    amplifier's lag of one pole takes the exponential from it.

    Every effect is set, whatever another chain has made of it before.
    """
    lag = next((effect for effect in effects if isinstance(effect, AmplifierLag)), None)
    decay = None if lag is None or lag.is_ideal() or lag.poles() > 1 else lag.decay
    for effect in effects:
        if isinstance(effect, Delay):
            effect.decay = decay
        if effect.hold is not None:
            effect.hold = "end" if held else "first"
        held = held and not effect.smooths and effect.hold is None
