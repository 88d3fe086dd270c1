"""The effects of a stage, as its file names them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from torchpi.errors import StageError
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.effect import Effect, Parameters
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.modal import MODAL, ModalEffect
from torchpi.stage.effects.unknown import Unknown

MOST_EFFECTS = 100


class EffectSettings(NamedTuple):
    """An effect of a stage: its kind, its parameters, and the auxiliary signal that it takes, if any."""

    kind: type[Effect] | type[InsideEffect] | type[ModalEffect]
    values: Parameters
    aux: str = ""

    def plain(self) -> dict[str, Any]:
        """Return the effect as `Stage` takes it."""
        entry = {"name": self.kind.name, "values": self.values, "aux": self.aux}
        return entry | {"modal": True} if issubclass(self.kind, ModalEffect) else entry

    def present(self, operator: Effect) -> Parameters:
        """Return the present parameters: those that were given, and those that training has changed."""
        return {
            name: value
            for name, value in operator.values().items()
            if name in self.values or value != operator.identity[name]
        }


def in_order(entries: Sequence[Mapping[str, Any]]) -> list[EffectSettings]:
    """Return effects, given as `Stage` takes them, in the order of the chain.

    Raises:
        StageError: An unknown effect, or an auxiliary signal that is missing or not taken.
    """
    kinds, found = {kind.name: kind for kind in (*EFFECTS, Unknown)}, []
    if len(entries) > MOST_EFFECTS:
        raise StageError(f"effects: found {len(entries)}, expected at most {MOST_EFFECTS}")
    for entry in entries:
        name, aux = entry.get("name"), entry.get("aux") or ""
        if name is None:
            raise StageError(f"effects: found an entry without a name, expected one of {', '.join(kinds)}")
        if name not in kinds:
            raise StageError(f"effects: found '{name}', expected one of {', '.join(kinds)}")
        kind = MODAL[name] if entry.get("modal") else kinds[name]
        if kind.takes_aux != bool(aux):
            expected = "the name of the signal that it uses" if kind.takes_aux else "none"
            raise StageError(f"{name}: found the auxiliary signal '{aux}', expected {expected}")
        values = {parameter: float(value) for parameter, value in (entry.get("values") or {}).items()}
        found.append(EffectSettings(kind, values, aux))
    order = list(kinds)
    return sorted(found, key=lambda one: order.index(one.kind.name))
