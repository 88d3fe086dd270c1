"""Different envelopes up and down: a generalised play (Brokate and Sprekels, 1996) with one parameter."""

from torchpi.stage.effects.effect import DataRange, Needs, Parameters, parameter
from torchpi.stage.effects.inside import InsideEffect


class HysteresisAsymmetry(InsideEffect):
    """h_i = max{v + a v² - r_i, min{v - a v² + r_i, h_i}}: a loop that is narrower, or wider, at the top."""

    name = "hysteresis_asymmetry"
    equation = "h = max{v + a v² - r, min{v - a v² + r, h}}"
    signature = "even lines of a multisine; the error going up differs from that coming down"
    time_scale = "static"
    needs = Needs(reversals=2)
    asymmetry_per_v: float = parameter("1/V", at_least=-0.2, at_most=0.2)

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        return [{"asymmetry_per_v": 0.01 / seen.span_v}]
