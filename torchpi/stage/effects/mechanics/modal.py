"""Named effects of a stage in which every input drives every mode: the parts of `Modes`."""

from collections.abc import Iterable, Mapping
from typing import ClassVar

from torchpi.operators.linear import Hold
from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import Block, DataRange, Described
from torchpi.stage.effects.mechanics.resonance import OF_A_MODE, is_sampled

MOST_MODES = 16
"""Largest number of modes that a stage may have."""
_SHARE = Quantity("", at_least=-1e3, at_most=1e3)
_RESIDUE = Quantity("µm/V", at_least=-1e4, at_most=1e4)


class ModalEffect(Described):
    """An effect that acts together with others of its kind as one `Modes`, without an operator of its own."""

    block: ClassVar[Block] = "mechanics"
    hold: Hold | None = "first"


class ModalResonance(ModalEffect):
    """The strongest mode."""

    name = "resonance"
    equation = "y = x + Σ s (M(x) - x) + Σ v Ṁ(x)/ω₀, over the modes M"
    signature = "rings at one frequency, phase lag grows towards it"
    time_scale = "fast"
    rings = True
    quantities: ClassVar[dict[str, Quantity]] = {**OF_A_MODE, "share": _SHARE, "rate_share": _SHARE}

    @classmethod
    def reached(cls, values: Mapping[str, float], seen: DataRange) -> bool:
        return is_sampled(values, seen)


class ModalSecondMode(ModalResonance):
    """Any other mode."""

    name = "second_mode"
    signature = "rings at one frequency beside the other modes"


class ModalCoupling(ModalEffect):
    """Motion that another axis causes in this one through the modes; mode 1 is the resonance, and the second
    modes follow in their order."""

    name = "cross_coupling"
    equation = "y = x + c a + Σ r (M(a) - a) + Σ q Ṁ(a)/ω₀, over the modes M"
    signature = "coherent with the other axis, whatever this one does"
    quantities: ClassVar[dict[str, Quantity]] = {
        "coupling_um_per_v": _RESIDUE,
        **{f"mode{k}_um_per_v": _RESIDUE for k in range(1, MOST_MODES + 1)},
        **{f"mode{k}_rate_um_per_v": _RESIDUE for k in range(1, MOST_MODES + 1)},
    }
    takes_aux = True

    @classmethod
    def of_modes(cls, numbers: Iterable[int]) -> set[str]:
        """Return the names of the parameters if there are these modes."""
        return {
            "coupling_um_per_v",
            *(n for k in numbers for n in (f"mode{k}_um_per_v", f"mode{k}_rate_um_per_v")),
        }


def mode_numbers(effects: Iterable[type]) -> list[int]:
    """Return the number that each mode among the effects has in the couplings."""
    numbers: list[int] = []
    for effect in effects:
        if effect is ModalResonance:
            numbers.append(1)
        elif effect is ModalSecondMode:
            numbers.append(max([1, *numbers]) + 1)
    return numbers


MODAL: dict[str, type[ModalEffect]] = {
    effect.name: effect for effect in (ModalResonance, ModalSecondMode, ModalCoupling)
}
