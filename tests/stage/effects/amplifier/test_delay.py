"""Delay: the stage's delay line, of fixed length."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.effect import Seen


class TestLaws(EffectLaws):
    def operator(self) -> Delay:
        return Delay(PERIOD_S, delay_s=0.0037)


@given(delay_s=st.floats(0.0, 0.01), fs_hz=st.sampled_from([1e3, 3e4]))
def test_a_ramp_comes_out_later_by_exactly_the_delay(delay_s, fs_hz):
    t = torch.arange(400, dtype=torch.float64)[None] / fs_hz
    y = Delay(1 / fs_hz, delay_s=delay_s)(t)[0]
    torch.testing.assert_close(y.detach(), (t - delay_s).clamp(min=0), rtol=0, atol=1e-12)


def test_the_state_has_one_shape_at_every_delay():
    x = wandering(1, 200)
    states = [Delay(1e-4, delay_s=delay_s)(x)[1] for delay_s in (0.0, 1e-3, 0.01)]
    assert {state.shape for state in states} == {(1, 102)}


def test_without_values_there_is_a_gradient_to_the_delay():
    effect, x = Delay(0.001), wandering(1, 50)
    effect(x)[0][0, 20].backward()
    assert effect.delay_s.grad.item() == pytest.approx(-(x[0, 20] - x[0, 19]).item() / 0.001)


def test_a_search_starts_between_a_twentieth_of_a_millisecond_and_two():
    delays = [start["delay_s"] for start in Delay.starts(Seen(1e4, 10.0, 0, 1, 1, 0, 1, {}))]
    assert delays[0] == 5e-5 and delays[-1] == 2e-3
