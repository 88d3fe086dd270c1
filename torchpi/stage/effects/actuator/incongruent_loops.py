"""Weights that depend on the bias: equal minor loops are no longer congruent (Mayergoyz, 2003)."""

from typing import ClassVar

from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import Parameters, Seen
from torchpi.stage.effects.inside import InsideEffect


class IncongruentLoops(InsideEffect):
    """w_i(v) = w_i (1 + κ v) for every play that has memory, r_i > 0."""

    name = "incongruent_loops"
    equation = "y = Σ w_i (1 + κ v) h_i"
    signature = "minor loops of one amplitude differ with the bias; even lines"
    quantities: ClassVar[dict[str, Quantity]] = {
        "incongruence_per_v": Quantity("1/V", at_least=-0.5, at_most=0.5)
    }
    identity: ClassVar[Parameters] = {"incongruence_per_v": 0.0}

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        return [{"incongruence_per_v": 0.02 / seen.span_v}]
