"""Slew limit: a voltage that follows no faster than a rate."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.amplifier.slew_limit import SlewLimit
from torchpi.stage.effects.effect import Seen


class TestLaws(EffectLaws):
    def operator(self) -> SlewLimit:
        return SlewLimit(PERIOD_S, rate_v_per_s=0.9)

    def test_saved_parameters_serve_any_sample_rate(self):
        held = wandering(1, 200)
        fine = SlewLimit(PERIOD_S / 10, rate_v_per_s=0.9)(held.repeat_interleave(10, 1))[0][:, 9::10]
        torch.testing.assert_close(fine, self.operator()(held)[0], rtol=0, atol=1e-12)


@given(rate=st.floats(0.1, 10.0), level=st.floats(-5.0, 5.0))
def test_a_step_becomes_a_ramp_that_ends_at_the_level(rate, level):
    v = SlewLimit(0.05, rate_v_per_s=rate)(torch.full((1, 80), level, dtype=torch.float64))[0][0]
    ramp = 0.05 * rate * torch.arange(1, 81, dtype=torch.float64)
    wanted = torch.sign(torch.tensor(level)) * ramp.clamp(max=abs(level))
    torch.testing.assert_close(v.detach(), wanted, rtol=0, atol=1e-11)


def test_it_is_never_faster_than_its_rate_and_does_nothing_to_what_is_slower():
    x = wandering(3, 500)
    fastest = torch.diff(x, dim=1).abs().max().item() / 0.1
    v = SlewLimit(0.1, rate_v_per_s=0.3 * fastest)(x)[0]
    assert torch.diff(v, dim=1).abs().max().item() <= 0.03 * fastest * (1 + 1e-12)
    assert not torch.equal(v, x)
    assert torch.equal(SlewLimit(0.1, rate_v_per_s=1.01 * fastest)(x)[0], x)


def test_gradient_reaches_the_rate_from_every_sample_that_lags():
    effect = SlewLimit(0.1, rate_v_per_s=2.0)
    v = effect(torch.tensor([[1.0, 1.0, 1.0, -5.0]], dtype=torch.float64))[0]
    v.sum().backward()
    assert v[0].tolist() == pytest.approx([0.2, 0.4, 0.6, 0.4])
    assert effect.rate_v_per_s.grad.item() == pytest.approx(0.1 * (1 + 2 + 3 + 2))


def test_a_search_starts_at_shares_of_the_fastest_rate_seen():
    rates = [start["rate_v_per_s"] for start in SlewLimit.starts(Seen(1e3, 1.0, 0, 1, 50.0, 0, 1, {}))]
    assert rates[0] == pytest.approx(10.0) and rates[-1] == pytest.approx(45.0)


def test_a_search_also_starts_between_the_usual_rates_and_those_of_edges() -> None:
    usual = Seen(1e3, 1.0, 0, 1, 50.0, 0, 1, {})
    edges = Seen(1e3, 1.0, 0, 1, 50.0, 0, 1, {}, peak_rate_v_s=5000.0)
    added = [start["rate_v_per_s"] for start in SlewLimit.starts(edges)[len(SlewLimit.starts(usual)) :]]
    assert added == sorted(added)
    assert 50.0 <= added[0] < added[-1] < 5000.0
    assert len(added) >= 4
