"""Weights that depend on the bias: equal minor loops are no longer congruent (Mayergoyz, 2003)."""

from torchpi.stage.effects.effect import DataRange, Needs, Parameters, parameter
from torchpi.stage.effects.inside import InsideEffect


class IncongruentLoops(InsideEffect):
    """w_i(v) = w_i (1 + κ v) for every play that has memory, r_i > 0.

    With q, the memoryless part changes oppositely, w_0(v) = w_0 (1 - q κ v): the loop grows about its chord.
    """

    name = "incongruent_loops"
    equation = "y = w_0 (1 - q κ v) v + Σ w_i (1 + κ v) h_i"
    signature = "minor loops of one amplitude differ with the bias; even lines"
    time_scale = "static"
    needs = Needs(reversals=3)
    incongruence_per_v: float = parameter("1/V", at_least=-0.5, at_most=0.5)
    straight_share: float = parameter("", at_least=0.0, at_most=10.0)

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        by_volt = 0.02 / seen.span_v
        return [{"incongruence_per_v": by_volt}, {"incongruence_per_v": by_volt, "straight_share": 0.3}]
