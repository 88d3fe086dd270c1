"""Hysteresis that follows the rate: weights (Ang et al., 2007) or thresholds (Al Janaideh et al., 2009).

    w_i(v̇) = w_i (1 + k v̇),    r_i(v̇) = r_i (1 + β |v̇|),    h_i = c v + (h_i - c v) [1 + γ ln(1 + |v̇|/v̇₀)]

The last widens the loop about its chord, of slope c, by γ for each factor e of rate, as loops of piezo
ceramics do.
"""

from typing import ClassVar

from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import Parameters, Seen
from torchpi.stage.effects.inside import InsideEffect


class RateDependentHysteresis(InsideEffect):
    """Weights, thresholds or the width of the loop, of every play that has memory, r_i > 0.

    v̇ is the difference to the sample before, divided by T, through a low-pass of `rate_filter_s`.
    """

    name = "rate_dependent_hysteresis"
    equation = "w_i (1 + k v̇), or r_i (1 + β |v̇|), or loop · [1 + γ ln(1 + |v̇|/v̇₀)]"
    signature = "like a delay in amplitude and frequency, and unlike one at reversals"
    quantities: ClassVar[dict[str, Quantity]] = {
        "weight_s_per_v": Quantity("s/V", at_least=-1.0, at_most=1.0),
        "threshold_s_per_v": Quantity("s/V", at_least=-0.01, at_most=1.0),
        "loop_per_e": Quantity("", at_least=-1.0, at_most=1.0),
        "chord_share": Quantity("", at_least=0.2, at_most=2.0),
        "reference_rate_v_s": Quantity("V/s", at_least=1e-3, at_most=1e6),
        "rate_filter_s": Quantity("s", at_least=0.0, at_most=0.1),
    }
    identity: ClassVar[Parameters] = {
        "weight_s_per_v": 0.0,
        "threshold_s_per_v": 0.0,
        "loop_per_e": 0.0,
        "chord_share": 1.0,
        "reference_rate_v_s": 1.0,
        "rate_filter_s": 0.0,
    }

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        return [
            {"weight_s_per_v": 0.01 / seen.max_rate_v_s},
            {"threshold_s_per_v": 0.02 / seen.max_rate_v_s},
            *(
                {
                    "loop_per_e": 0.02,
                    "chord_share": 0.85,
                    "reference_rate_v_s": share * seen.max_rate_v_s,
                    "rate_filter_s": samples / seen.fs_hz,
                }
                for share in (0.003, 0.1)
                for samples in (5.0, 40.0)
            ),
        ]
