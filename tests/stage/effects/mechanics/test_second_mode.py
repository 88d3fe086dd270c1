"""Second mode: a share of the displacement goes through a mode."""

import torch

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.mechanics.second_mode import SecondMode

MODE = {"frequency_hz": 1.3, "damping_ratio": 0.05}


class TestLaws(EffectLaws):
    def operator(self) -> SecondMode:
        return SecondMode(PERIOD_S, share=0.3, **MODE)


def test_the_output_is_the_weighted_mean_of_the_input_and_a_resonance():
    x = wandering(2, 300)
    y, through = SecondMode(0.1, share=0.3, **MODE)(x)[0], Resonance(0.1, **MODE)(x)[0]
    torch.testing.assert_close(y, 0.7 * x + 0.3 * through, rtol=0, atol=1e-12)


def test_at_zero_share_the_gradient_is_the_change_that_a_mode_would_make():
    effect, x = SecondMode(1e-4), wandering(1, 60)
    effect(x)[0][0, 50].backward()
    change = Resonance(1e-4, **{name: effect.identity[name] for name in MODE})(x)[0] - x
    torch.testing.assert_close(effect.share.grad, change[0, 50].detach(), rtol=0, atol=1e-12)


def test_a_search_starts_with_a_small_share_at_each_frequency():
    starts = SecondMode.starts(DataRange(2e4, 1.0, 0, 1, 1, 0, 1, {}))
    assert {start["share"] for start in starts} == {0.05}
    assert all(set(start) == {"share", *MODE} for start in starts)
