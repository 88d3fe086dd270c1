"""Stiction: the output sticks after a reversal and returns to the input after the breakaway."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.operators.play import PlayBank
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.mechanics.stiction import Stiction


class TestLaws(EffectLaws):
    def operator(self) -> Stiction:
        return Stiction(PERIOD_S, breakaway_um=0.23, sliding_um=0.09)


def test_it_sticks_at_a_reversal_jumps_back_and_follows():
    x = torch.tensor([[0.5, 1.0, 3.0, 2.5, 2.25, 1.5, 1.0, 1.0, 0.5, 0.75, 1.75]], dtype=torch.float64)
    y = Stiction(0.1, breakaway_um=1.0)(x)[0]
    assert y[0].tolist() == [0.0, 1.0, 3.0, 3.0, 3.0, 1.5, 1.0, 1.0, 0.5, 0.5, 1.75]


@given(breakaway_um=st.floats(0.0, 3.0), seed=st.integers(0, 10**6))
def test_the_output_moves_only_to_the_input_and_stays_within_the_breakaway_of_it(breakaway_um, seed):
    x = wandering(1, 200, seed)
    y = Stiction(0.1, breakaway_um=breakaway_um)(x)[0]
    assert bool(((y == x) | ((y - x).abs() < breakaway_um)).all())
    moved = torch.diff(y, dim=1) != 0
    assert torch.equal(y[:, 1:][moved], x[:, 1:][moved])


@given(seed=st.integers(0, 10**6))
def test_with_sliding_friction_equal_to_the_breakaway_it_is_a_play(seed):
    x = wandering(1, 200, seed)
    y = Stiction(0.1, breakaway_um=0.3, sliding_um=0.3)(x)[0]
    torch.testing.assert_close(y, PlayBank([0.3])(x)[0][..., 0], rtol=0, atol=1e-12)


def test_if_it_rests_at_every_sample_it_moves_in_jumps():
    x = torch.arange(0.0, 3.0, 0.25, dtype=torch.float64)[None]
    y = Stiction(0.1, breakaway_um=1.0, rests=1.0)(x)[0]
    assert y[0].tolist() == [0.0] * 4 + [1.0] * 4 + [2.0] * 4


def test_the_form_is_breakaway_or_stick_slip():
    assert Stiction.form({"sliding_um": 0.1, "rests": 1.0}) == ""
    assert Stiction.form({"breakaway_um": 0.1}) == "breakaway"
    assert Stiction.form({"breakaway_um": 0.1, "rests": 1.0}) == "stick-slip"


def test_a_rest_does_not_count_as_a_reversal():
    x = wandering(1, 200)
    effect = Stiction(0.1, breakaway_um=0.2)
    assert torch.equal(effect(x.repeat_interleave(3, 1))[0][:, 2::3], effect(x)[0])


def test_a_search_starts_at_small_fractions_of_the_travel():
    sizes = [start["breakaway_um"] for start in Stiction.starts(DataRange(1e4, 1.0, 0, 1, 1, 0, 20.0, {}))]
    assert sizes[0] == pytest.approx(0.02) and sizes[-1] == pytest.approx(0.4)
