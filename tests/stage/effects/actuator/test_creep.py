"""Creep: y₀ [1 + γ log₁₀(t / 0.1 s)] between two times, poles in parallel, a power law, or sums of these."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws, step
from torchpi.errors import StageError
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.actuator.creep import FROM_S, TO_S, Creep, bank
from torchpi.stage.effects.effect import DataRange


class TestLaws(EffectLaws):
    def operator(self) -> Creep:
        return Creep(
            PERIOD_S,
            per_decade=0.03,
            gain=0.04,
            time_constant_s=0.7,
            slow_gain=0.03,
            slow_time_constant_s=6.0,
            power_per_decade=0.02,
            exponent=0.3,
            from_s=0.004,  # at the default value, any smaller one adds a pole
        )


class TestLawsOfAnotherRange(EffectLaws):
    def operator(self) -> Creep:
        return Creep(PERIOD_S, per_decade=0.03, gain=0.04, time_constant_s=0.7, from_s=0.2, to_s=5.0)


def logarithm(per_decade: float, period_s: float, until_s: float, **times: float) -> torch.Tensor:
    """Return y(t) after a unit step, y[k] at t = k T."""
    return Creep(period_s, per_decade=per_decade, **times)(step(round(until_s / period_s) + 1))[0][0].detach()


@given(per_decade=st.floats(-0.05, 0.05))
def test_creep_grows_by_the_given_share_in_every_decade(per_decade):
    for times in ({}, {"from_s": 0.1, "to_s": 100.0}):
        y = logarithm(per_decade, 1e-2, 100.0, **times)
        after = {seconds: y[round(seconds / 1e-2)].item() for seconds in (0.1, 1.0, 10.0, 100.0)}
        # The step takes one sample to rise.
        assert after[0.1] == pytest.approx(1.0, abs=0.1 * abs(per_decade) + 1e-12)
        for start in (0.1, 1.0, 10.0):
            assert after[10 * start] - after[start] == pytest.approx(per_decade, rel=0.06, abs=1e-12)


def test_the_response_follows_the_logarithm_between_decades_too():
    y = logarithm(0.02, 1e-3, 10.0, from_s=0.01, to_s=100.0)
    t = torch.logspace(-1.5, 1, 40, dtype=torch.float64)
    found = y[(t / 1e-3).round().long()]
    wanted = 1 + 0.02 * torch.log10((t / 1e-3).round() * 1e-3 / 0.1)
    torch.testing.assert_close(found, wanted, rtol=0, atol=0.03 * 0.02)


def test_its_poles_run_from_a_millisecond_to_a_thousand_seconds_by_default():
    taus = -1e-3 / bank(1e-3, torch.tensor(FROM_S, dtype=torch.float64), TO_S).a.log()
    assert taus[0].item() == pytest.approx(1e-3) and taus[-1].item() == pytest.approx(1e3, rel=1e-6)
    taus = -1e-3 / bank(1e-3, torch.tensor(0.1, dtype=torch.float64), 10.0).a.log()
    assert taus[0].item() == pytest.approx(0.1 / 10**0.5) and taus[-1].item() == pytest.approx(
        100.0, rel=1e-6
    )


def test_the_gradient_is_continuous_where_a_pole_is_added_at_the_far_end():
    def moved(from_s):
        return Creep(1e-3, per_decade=0.03, from_s=from_s)(wandering(1, 200))[0].square().sum().item()

    effect = Creep(1e-3, per_decade=0.03, from_s=0.01)
    effect(wandering(1, 200))[0].square().sum().backward()
    slopes = (moved(0.01) - moved(0.01 - 1e-7)) / 1e-7, (moved(0.01 + 1e-7) - moved(0.01)) / 1e-7
    assert len(Creep(1e-3, from_s=0.01 - 1e-7).bank().a) == len(effect.bank().a) + 1
    assert slopes == pytest.approx([effect.from_s.grad.item()] * 2, rel=0.01)
    assert effect.to_s.grad is None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"per_decade": math.inf}, "per_decade: found inf, expected -0.5 to 0.5"),
        ({"per_decade": 0.01, "from_s": 0.0}, "from_s: found 0 s, expected 1e-09 to"),
        (
            {"per_decade": 0.01, "from_s": 2.0, "to_s": 1.0},
            "to_s: found 1 s, expected more than from_s = 2 s",
        ),
    ],
)
def test_unphysical_creep_is_refused(values, message):
    with pytest.raises(StageError, match=message):
        Creep(1e-4, **values)


@given(gain=st.floats(0.001, 0.2), time_constant_s=st.floats(1e-3, 1e3))
def test_one_pole_settles_exponentially(gain, time_constant_s):
    period_s = 1e-2
    y = Creep(period_s, gain=gain, time_constant_s=time_constant_s)(step(400))[0][0].detach()
    z = period_s / time_constant_s
    at_once = 1 + math.expm1(-z) / z if z > 1e-4 else z / 2 - z**2 / 6  # the step takes one sample to rise
    wanted = 1 + gain * (1 - (1 - at_once) * torch.exp(-z * torch.arange(400, dtype=torch.float64)))
    torch.testing.assert_close(y, wanted, rtol=0, atol=1e-11)


@pytest.mark.parametrize("exponent", [0.05, 0.15, 0.3])
def test_creep_during_a_hold_follows_the_power_law_over_three_decades(exponent):
    y = Creep(1e-2, power_per_decade=0.02, exponent=exponent)(step(10_001))[0][0].detach()
    t = 1e-2 * torch.arange(10_001, dtype=torch.float64)
    expected = 0.02 * ((t / 0.1) ** exponent - 1) / (exponent * math.log(10))
    grown = y - y[10]
    # The slowest pole is at 1000 s, so slower relaxations are missing at the end of a long hold.
    for k in (3, 30, 100, 1000, 10_000):
        assert grown[k].item() == pytest.approx((expected[k] - expected[10]).item(), rel=0.1)


def test_with_a_small_exponent_the_power_law_approaches_the_logarithm():
    x = wandering(1, 400)
    log, power = Creep(0.01, per_decade=0.03), Creep(0.01, power_per_decade=0.03, exponent=0.02)
    assert (log(x)[0] - power(x)[0]).abs().max() < 0.1 * (log(x)[0] - x).abs().max()


def test_the_forms_in_use_are_named():
    assert Creep.form({"time_constant_s": 3.0, "exponent": 0.1}) == ""
    assert Creep.form({"per_decade": 0.01, "gain": 0.2}) == "logarithm + pole"
    assert Creep.form({"gain": 0.01, "slow_gain": 0.02}) == "two poles"
    assert Creep.form({"gain": 0.0, "slow_gain": 0.02}) == "pole"
    assert Creep.form({"power_per_decade": 0.01}) == "power law"


@pytest.mark.parametrize("values", [{"per_decade": 0.02}, {"gain": 0.05, "time_constant_s": 0.3}])
def test_the_tangent_of_either_form_alone_equals_the_effect(values):
    effect, dx = Creep(0.01, **values), wandering(3, 200)
    torch.testing.assert_close(effect.tangent(dx[:1], dx), effect(dx)[0].detach(), rtol=0, atol=1e-14)


def test_the_contributions_of_the_forms_add_up():
    x = wandering(1, 300)
    log, pole = {"per_decade": 0.02}, {"gain": 0.05, "time_constant_s": 0.3}
    slow = {"slow_gain": 0.03, "slow_time_constant_s": 4.0}
    parts = sum(Creep(0.01, **values)(x)[0] - x for values in (log, pole, slow))
    torch.testing.assert_close(Creep(0.01, **log, **pole, **slow)(x)[0] - x, parts, rtol=0, atol=1e-14)


def test_both_poles_respond_alike_for_equal_values():
    x = wandering(1, 300)
    first = Creep(0.01, gain=0.05, time_constant_s=0.3)(x)[0]
    torch.testing.assert_close(
        Creep(0.01, slow_gain=0.05, slow_time_constant_s=0.3)(x)[0], first, rtol=0, atol=1e-14
    )


def test_a_pole_faster_than_the_voltage_does_not_count_as_creep():
    """On a 1 Hz sine, a pole of 35 ms acts as a lag whatever its gain; jumps reveal the gain."""
    sine, jumps = (DataRange(1e4, 10.0, 0, 10, 1, 0, 10, {}, quickest_s=one) for one in (0.16, 1e-3))
    quick, slow = ({"gain": 0.4, "time_constant_s": tau} for tau in (0.035, 0.2))
    assert not Creep.reached(quick, sine) and Creep.reached(slow, sine) and Creep.reached(quick, jumps)
    assert not Creep.reached({**slow, "slow_gain": 0.1, "slow_time_constant_s": 0.035}, sine)
    assert Creep.reached({"per_decade": 0.01}, sine)
    begins = {"per_decade": 0.01, "from_s": 0.035}
    assert not Creep.reached(begins, sine) and Creep.reached(begins, jumps)
    assert Creep.reached({**begins, "from_s": 0.06}, sine)
    assert all(Creep.reached(start, sine) for start in Creep.starts(sine))
