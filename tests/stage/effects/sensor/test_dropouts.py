"""Dropouts: the stage itself predicts none; they are found in the readings."""

import torch

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.sensor.dropouts import Dropouts


class TestLaws(EffectLaws):
    differentiable = False

    def operator(self) -> Dropouts:
        return Dropouts(PERIOD_S, share=0.01)


def test_the_stage_predicts_no_dropouts():
    x = wandering(2, 50)
    assert torch.equal(Dropouts(1e-4, share=0.5)(x)[0], x)


def test_a_search_has_no_starts_because_dropouts_are_read_off_the_readings():
    assert Dropouts.starts(DataRange(1e4, 1.0, 0, 1, 1, 0, 1, {})) == []
