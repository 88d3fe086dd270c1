"""Cross coupling: another signal is added."""

import pytest
import torch

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.mechanics.cross_coupling import CrossCoupling


class TestLaws(EffectLaws):
    def operator(self) -> CrossCoupling:
        return CrossCoupling(PERIOD_S, coupling_um_per_v=0.2)


def test_the_other_signal_is_added_with_exact_gradients():
    effect = CrossCoupling(0.1, coupling_um_per_v=0.2)
    x, aux = wandering(2, 30), wandering(2, 30, seed=1)
    torch.testing.assert_close(effect(x, aux=aux)[0].detach(), x + 0.2 * aux, rtol=0, atol=1e-15)

    def output(x, aux, c):
        return torch.func.functional_call(effect, {"coupling_um_per_v": c}, (x, None, aux))[0]

    inputs = [part.detach().clone().requires_grad_() for part in (x, aux, effect.coupling_um_per_v)]
    assert torch.autograd.gradcheck(output, inputs)


def test_at_zero_coupling_nothing_is_added_and_the_gradient_is_the_other_signal():
    effect, x, aux = CrossCoupling(0.1), wandering(1, 30), wandering(1, 30, seed=1)
    y = effect(x, aux=aux)[0]
    assert torch.equal(y, x)
    y[0, 7].backward()
    assert effect.coupling_um_per_v.grad.item() == aux[0, 7].item()


def test_a_search_starts_at_a_coupling_of_one_per_cent_of_the_travel():
    seen = DataRange(1e4, 1.0, 0, 1, 1, 0, 20.0, {"aux_v": 0.5})
    assert CrossCoupling.starts(seen) == [{"coupling_um_per_v": pytest.approx(0.4)}]
