"""Load change: a spring load reduces the displacement and raises the frequency."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.mechanics.load_change import LoadChange


class TestLaws(EffectLaws):
    def operator(self) -> LoadChange:
        return LoadChange(PERIOD_S, stiffness_ratio=0.2)


@given(actuator=st.floats(1.0, 100.0), share=st.floats(0.0, 9.0))
def test_the_gain_is_that_of_two_springs(actuator, share):
    load = share * actuator
    effect, x = LoadChange(0.1, stiffness_ratio=share), wandering(1, 50)
    torch.testing.assert_close(effect(x)[0].detach(), actuator / (actuator + load) * x, rtol=1e-12, atol=0)


def test_each_recording_has_a_stiffness_ratio_of_its_own():
    assert LoadChange.per_recording == ("stiffness_ratio",)
