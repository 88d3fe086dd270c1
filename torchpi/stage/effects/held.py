"""How each block's input behaves between samples, which depends on the blocks before it."""

from collections.abc import Sequence

from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.effect import Effect


def hold_first_block(effects: Sequence[Effect], held: bool) -> None:
    """Set, for every effect of a chain that needs it, how its input behaves between samples.

    If the command is held during each sample, so is the input of the first dynamic block. Behind that block,
    and behind an amplifier with a lag or slew limit, a signal is linear between samples. A delay behind an
    amplifier's lag of one pole uses the exponential of that lag.

    Every effect is set anew, whatever another chain has set before.
    """
    lag = next((effect for effect in effects if isinstance(effect, AmplifierLag)), None)
    decay = None if lag is None or lag.is_ideal() or lag.poles() > 1 else lag.decay
    for effect in effects:
        if isinstance(effect, Delay):
            effect.decay = decay
        if effect.hold is not None:
            effect.hold = "end" if held else "first"
        held = held and not effect.smooths and effect.hold is None
