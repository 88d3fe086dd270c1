"""A held command makes a stepped displacement: the first block with memory of its own must know."""

from collections.abc import Sequence

from torchpi.stage.effects.effect import Effect


def hold_first_block(effects: Sequence[Effect], held: bool) -> None:
    """Tell the first dynamic block of a chain that its input is held through each sample, if it is.

    Behind it, and behind an amplifier that is slow itself, a signal runs straight from sample to sample.
    """
    for effect in effects:
        if effect.smooths:
            return
        if effect.hold is not None:
            effect.hold = "end" if held else "first"
            return
