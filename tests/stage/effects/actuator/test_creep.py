"""Creep as an effect: the logarithm of `torchpi.operators.creep`, one pole beside it, or both."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws, step
from torchpi.operators import creep
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.actuator.creep import FROM_S, TO_S, Creep


class TestLaws(EffectLaws):
    def operator(self) -> Creep:
        return Creep(
            PERIOD_S, per_decade=0.03, gain=0.04, time_constant_s=0.7, power_per_decade=0.02, exponent=0.3
        )


@given(per_decade=st.floats(0, 0.05), fs_hz=st.sampled_from([100.0, 1e4, 1e5]))
def test_the_logarithm_is_that_of_the_operator(per_decade, fs_hz):
    x = wandering(2, 500)
    wanted = creep.Creep(1 / fs_hz, per_decade, FROM_S, TO_S)(x)[0]
    torch.testing.assert_close(Creep(1 / fs_hz, per_decade=per_decade)(x)[0], wanted, rtol=0, atol=1e-13)


def test_its_poles_run_from_a_millisecond_to_a_thousand_seconds():
    decays = Creep(1e-3).decays
    taus = -1e-3 / decays.log()
    assert taus[0].item() == pytest.approx(1e-3) and taus[-1].item() == pytest.approx(1e3, rel=1e-6)


def test_every_decade_of_a_hold_adds_its_share():
    y = Creep(1e-2, per_decade=0.02)(step(10_001))[0][0].detach()
    assert y[10].item() == pytest.approx(1.0, abs=0.1 * 0.02)
    for first in (10, 100, 1000):
        assert (y[10 * first] - y[first]).item() == pytest.approx(0.02, rel=0.05)


@given(gain=st.floats(0.001, 0.2), time_constant_s=st.floats(1e-3, 1e3))
def test_one_pole_settles_as_an_exponential(gain, time_constant_s):
    period_s = 1e-2
    y = Creep(period_s, gain=gain, time_constant_s=time_constant_s)(step(400))[0][0].detach()
    z = period_s / time_constant_s
    at_once = 1 + math.expm1(-z) / z if z > 1e-4 else z / 2 - z**2 / 6  # the step takes one sample to rise
    wanted = 1 + gain * (1 - (1 - at_once) * torch.exp(-z * torch.arange(400, dtype=torch.float64)))
    torch.testing.assert_close(y, wanted, rtol=0, atol=1e-11)


@pytest.mark.parametrize("exponent", [0.05, 0.15, 0.3])
def test_a_hold_creeps_by_the_power_law_over_three_decades(exponent):
    y = Creep(1e-2, power_per_decade=0.02, exponent=exponent)(step(10_001))[0][0].detach()
    t = 1e-2 * torch.arange(10_001, dtype=torch.float64)
    expected = 0.02 * ((t / 0.1) ** exponent - 1) / (exponent * math.log(10))
    grown = y - y[10]
    # Poles end at 1000 s: what lies beyond them is missing at the end of a long hold.
    for k in (3, 30, 100, 1000, 10_000):
        assert grown[k].item() == pytest.approx((expected[k] - expected[10]).item(), rel=0.1)


def test_a_small_exponent_is_the_logarithm():
    x = wandering(1, 400)
    log, power = Creep(0.01, per_decade=0.03), Creep(0.01, power_per_decade=0.03, exponent=0.02)
    assert (log(x)[0] - power(x)[0]).abs().max() < 0.1 * (log(x)[0] - x).abs().max()


def test_the_forms_in_use_are_named():
    assert Creep.form({"time_constant_s": 3.0, "exponent": 0.1}) == ""
    assert Creep.form({"per_decade": 0.01, "gain": 0.2}) == "logarithm + pole"
    assert Creep.form({"power_per_decade": 0.01}) == "power law"


@pytest.mark.parametrize("values", [{"per_decade": 0.02}, {"gain": 0.05, "time_constant_s": 0.3}])
def test_tangent_of_either_kind_alone_is_the_effect_itself(values):
    effect, dx = Creep(0.01, **values), wandering(3, 200)
    torch.testing.assert_close(effect.tangent(dx[:1], dx), effect(dx)[0].detach(), rtol=0, atol=1e-14)


def test_both_add_up():
    x = wandering(1, 300)
    log, pole = {"per_decade": 0.02}, {"gain": 0.05, "time_constant_s": 0.3}
    parts = sum(Creep(0.01, **values)(x)[0] - x for values in (log, pole))
    torch.testing.assert_close(Creep(0.01, **log, **pole)(x)[0] - x, parts, rtol=0, atol=1e-14)
