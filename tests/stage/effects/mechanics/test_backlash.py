"""Backlash: a play in series, against that of python-control."""

import control
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import Seen
from torchpi.stage.effects.mechanics.backlash import Backlash


class TestLaws(EffectLaws):
    def operator(self) -> Backlash:
        return Backlash(PERIOD_S, width_um=0.3)


@given(width_um=st.floats(0.0, 3.0), seed=st.integers(0, 10**6))
def test_it_is_the_backlash_of_python_control(width_um, seed):
    x = wandering(1, 100, seed)
    oracle = control.friction_backlash_nonlinearity(width_um)
    oracle.center = 0.0
    y = Backlash(0.1, width_um=width_um)(x)[0][0]
    assert y.tolist() == pytest.approx([oracle(sample) for sample in x[0].tolist()], abs=1e-12)


def test_without_values_the_gradient_to_the_width_is_half_against_the_motion():
    effect, x = Backlash(0.1), torch.tensor([[0.5, 1.0, 2.0, 1.5, 1.0]], dtype=torch.float64)
    y = effect(x)[0][0]
    gradients = [torch.autograd.grad(y[t], effect.width_um, retain_graph=True)[0].item() for t in range(5)]
    assert gradients == [-0.5, -0.5, -0.5, 0.5, 0.5]


def test_a_search_starts_at_small_shares_of_the_travel():
    widths = [start["width_um"] for start in Backlash.starts(Seen(1e4, 1.0, 0, 1, 1, 0, 20.0, {}))]
    assert widths[0] == pytest.approx(0.02) and widths[-1] == pytest.approx(0.4)
