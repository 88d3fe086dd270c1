"""Slew limit: the voltage follows the command no faster than a given rate."""

import numpy as np
import pytest
import scipy.integrate
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws, fixed
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.amplifier.slew_limit import SlewLimit
from torchpi.stage.effects.effect import DataRange


class TestHardLaws(EffectLaws):
    def operator(self) -> SlewLimit:
        return fixed(SlewLimit(PERIOD_S, rate_v_per_s=0.9), "knee_v")

    def test_saved_parameters_are_valid_at_any_sample_rate(self):
        held = wandering(1, 200)
        fine = SlewLimit(PERIOD_S / 10, rate_v_per_s=0.9)(held.repeat_interleave(10, 1))[0][:, 9::10]
        torch.testing.assert_close(fine, self.operator()(held)[0], rtol=0, atol=1e-12)


@given(rate=st.floats(0.1, 10.0), level=st.floats(-5.0, 5.0))
def test_a_step_becomes_a_ramp_that_ends_at_the_level(rate, level):
    v = SlewLimit(0.05, rate_v_per_s=rate)(torch.full((1, 80), level, dtype=torch.float64))[0][0]
    ramp = 0.05 * rate * torch.arange(1, 81, dtype=torch.float64)
    wanted = torch.sign(torch.tensor(level)) * ramp.clamp(max=abs(level))
    torch.testing.assert_close(v.detach(), wanted, rtol=0, atol=1e-11)


def test_the_output_never_exceeds_the_rate_and_slower_inputs_pass_unchanged():
    x = wandering(3, 500)
    fastest = torch.diff(x, dim=1).abs().max().item() / 0.1
    v = SlewLimit(0.1, rate_v_per_s=0.3 * fastest)(x)[0]
    assert torch.diff(v, dim=1).abs().max().item() <= 0.03 * fastest * (1 + 1e-12)
    assert not torch.equal(v, x)
    assert torch.equal(SlewLimit(0.1, rate_v_per_s=1.01 * fastest)(x)[0], x)


def test_every_lagging_sample_contributes_to_the_gradient_of_the_rate():
    effect = SlewLimit(0.1, rate_v_per_s=2.0)
    v = effect(torch.tensor([[1.0, 1.0, 1.0, -5.0]], dtype=torch.float64))[0]
    v.sum().backward()
    assert v[0].tolist() == pytest.approx([0.2, 0.4, 0.6, 0.4])
    assert effect.rate_v_per_s.grad.item() == pytest.approx(0.1 * (1 + 2 + 3 + 2))


def test_a_search_starts_at_fractions_of_the_fastest_rate_seen():
    starts = SlewLimit.starts(DataRange(1e3, 1.0, 0, 1, 50.0, 0, 1, {}))
    rates = [start["rate_v_per_s"] for start in starts if "knee_v" not in start]
    assert rates[0] == pytest.approx(10.0) and rates[-1] == pytest.approx(45.0)


def test_a_search_also_starts_between_the_usual_rates_and_those_of_edges() -> None:
    usual = DataRange(1e3, 1.0, 0, 1, 50.0, 0, 1, {})
    edges = DataRange(1e3, 1.0, 0, 1, 50.0, 0, 1, {}, peak_rate_v_s=5000.0)
    known = [start["rate_v_per_s"] for start in SlewLimit.starts(usual)]
    hard = [start["rate_v_per_s"] for start in SlewLimit.starts(edges) if "knee_v" not in start]
    added = [rate for rate in hard if rate not in known]
    assert added == sorted(added)
    assert 50.0 <= added[0] < added[-1] < 5000.0
    assert len(added) >= 4


def test_if_edges_set_the_usual_rates_a_search_also_starts_far_below_them() -> None:
    """For a raster and stairs at 500 Hz over 20 V, no fit from 1,200 V/s reached the limit of 200 V/s."""
    seen = DataRange(500.0, 5.0, -10, 10, 6000.0, 0, 1, {}, peak_rate_v_s=8000.0)
    rates = np.array([start["rate_v_per_s"] for start in SlewLimit.starts(seen) if "knee_v" not in start])
    for limit_v_s in (50.0, 200.0, 800.0, 5000.0):
        assert np.abs(np.log(rates / limit_v_s)).min() < np.log(1.5)


class TestSoftLaws(EffectLaws):
    def operator(self) -> SlewLimit:
        return SlewLimit(PERIOD_S, rate_v_per_s=0.9, knee_v=0.13)

    def test_saved_parameters_are_valid_at_any_sample_rate(self):
        held = wandering(1, 200)
        fine = SlewLimit(PERIOD_S / 10, rate_v_per_s=0.9, knee_v=0.13)(held.repeat_interleave(10, 1))[0]
        torch.testing.assert_close(fine[:, 9::10], self.operator()(held)[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("knee_v", [0.02, 0.3, 4.0, 200.0])
def test_a_soft_limit_solves_its_differential_equation_for_a_held_command(knee_v):
    u, rate = 3.0, 2.0
    v = SlewLimit(0.1, rate_v_per_s=rate, knee_v=knee_v)(torch.full((1, 40), u, dtype=torch.float64))[0][0]
    solved = scipy.integrate.solve_ivp(
        lambda _, v: rate * np.tanh((u - v) / knee_v),
        (0, 4),
        [0.0],
        method="Radau",
        t_eval=0.1 * np.arange(1, 41),
        rtol=1e-11,
        atol=1e-12,
    )
    np.testing.assert_allclose(v.detach().numpy(), solved.y[0], rtol=0, atol=1e-8)


@given(knee_v=st.floats(1e-9, 1e4), rate=st.floats(1e-3, 1e9), level=st.floats(-100.0, 100.0))
def test_a_soft_limit_is_finite_and_never_ahead_of_the_hard_one(knee_v, rate, level):
    u = torch.tensor([[0.0, level, level, level]], dtype=torch.float64)
    hard = SlewLimit(0.01, rate_v_per_s=rate)(u)[0].abs()
    soft = SlewLimit(0.01, rate_v_per_s=rate, knee_v=knee_v)(u)[0].abs()
    assert bool((soft <= hard + 1e-12 * abs(level)).all())
    assert bool(torch.isfinite(soft).all())


def test_with_a_small_knee_the_soft_limit_equals_the_hard_one():
    x = wandering(2, 300)
    hard, soft = (SlewLimit(0.1, rate_v_per_s=0.9, knee_v=knee)(x)[0] for knee in (0.0, 1e-9))
    torch.testing.assert_close(soft, hard, rtol=0, atol=1e-8)


def test_the_form_is_hard_or_soft_depending_on_the_knee():
    assert SlewLimit.form({}) == "" == SlewLimit.form({"knee_v": 0.1})
    assert SlewLimit.form({"rate_v_per_s": 3.0}) == "hard"
    assert SlewLimit.form({"rate_v_per_s": 3.0, "knee_v": 0.1}) == "soft"
