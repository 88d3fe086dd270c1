"""Hysteresis that depends on the rate: weights (Ang et al., 2007) or thresholds (Al Janaideh et al., 2009).

    w_i(v̇) = w_i (1 + k v̇),    r_i(v̇) = r_i (1 + β |v̇|),    h_i = c v + (h_i - c v) [1 + γ ln(1 + |v̇|/v̇₀)]

The third form widens the loop about its chord, of slope c, by γ for each factor e of the rate, as loops of
piezo ceramics do. In the fourth every play relaxes, with a time constant τ, towards the position of the
ordinary play (`torchpi.stage.effects.actuator.relaxing_plays`).
"""

import math
from collections.abc import Mapping
from typing import ClassVar

from torchpi.stage.effects.effect import DataRange, Needs, Parameters, parameter
from torchpi.stage.effects.inside import InsideEffect

RELAXATIONS = (1e-4, 1e-3, 1e-2, 1e-1)
"""Time constants, as shares of the longest recording, from which a fit starts."""


class RateDependentHysteresis(InsideEffect):
    """Rate-dependent weights, thresholds, loop width or lag of every play that has memory, r_i > 0.

    v̇ is the backward difference divided by T, through a low-pass of time constant `rate_filter_s`.
    """

    name = "rate_dependent_hysteresis"
    needs = Needs(reversals=2, pace=1.5)
    # A rate-dependent effect whose equation does not quite match the rig leaves a rate-dependent residual.
    left_by = ("resonance", "second_mode", "amplifier_lag", "sensor_lag", "delay", "slew_limit")
    equation = "w_i (1 + k v̇), or r_i (1 + β |v̇|), or loop · [1 + γ ln(1 + |v̇|/v̇₀)], or τ ḣ_i = p_i - h_i"
    signature = "resembles a delay in amplitude and frequency, but differs from one at reversals"
    weight_s_per_v: float = parameter("s/V", at_least=-1.0, at_most=1.0)
    threshold_s_per_v: float = parameter("s/V", at_least=-0.01, at_most=1.0)
    loop_per_e: float = parameter("", at_least=-1.0, at_most=1.0)
    chord_share: float = parameter("", at_least=0.2, at_most=2.0, identity=1.0)
    reference_rate_v_s: float = parameter("V/s", at_least=1e-3, at_most=1e6, identity=1.0)
    rate_filter_s: float = parameter("s", at_least=0.0, at_most=1e3)
    relaxation_s: float = parameter("s", at_least=0.0, at_most=1e3)
    forms = ("weights", "thresholds", "loop width", "relaxing plays")
    form_of: ClassVar[dict[str, str]] = {
        "weight_s_per_v": "weights",
        "threshold_s_per_v": "thresholds",
        "loop_per_e": "loop width",
        "relaxation_s": "relaxing plays",
    }

    @classmethod
    def reached(cls, values: Mapping[str, float], seen: DataRange) -> bool:
        return values.get("relaxation_s", math.inf) >= seen.quickest_s

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        # A play that has relaxed before the voltage moves on looks like a lag.
        taus = [tau for tau in (share * seen.duration_s for share in RELAXATIONS) if tau > seen.quickest_s]
        return [
            {"weight_s_per_v": 0.01 / seen.max_rate_v_s},
            {"threshold_s_per_v": 0.02 / seen.max_rate_v_s},
            *({"relaxation_s": tau} for tau in taus),
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
