"""Creep follows y₀ [1 + γ log₁₀(t / 0.1 s)] between its stated times."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.errors import StageError
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.operators.creep import Creep


class TestLaws(OperatorLaws):
    def operator(self) -> Creep:
        return Creep(sample_period_s=0.1, per_decade=0.03, from_s=0.2, to_s=5.0)


def step_response(per_decade: float, period_s: float, until_s: float, **times: float) -> torch.Tensor:
    """y(t) after a unit step, y[k] at t = k T."""
    y, _ = Creep(period_s, per_decade, **times)(
        torch.ones(1, round(until_s / period_s) + 1, dtype=torch.float64)
    )
    return y[0].detach()


@given(per_decade=st.floats(-0.05, 0.05))
def test_every_decade_adds_its_share(per_decade):
    y = step_response(per_decade, 1e-2, 100.0, from_s=0.1, to_s=100.0)
    after = {seconds: y[round(seconds / 1e-2)].item() for seconds in (0.1, 1.0, 10.0, 100.0)}
    assert after[0.1] == pytest.approx(1.0, abs=0.06 * abs(per_decade))  # the step takes one sample to rise
    for start in (0.1, 1.0, 10.0):
        assert after[10 * start] - after[start] == pytest.approx(per_decade, rel=0.06, abs=1e-12)


def test_the_logarithm_is_followed_between_decades_too():
    y = step_response(0.02, 1e-3, 10.0, from_s=0.01, to_s=100.0)
    t = torch.logspace(-1.5, 1, 40, dtype=torch.float64)
    found = y[(t / 1e-3).round().long()]
    wanted = 1 + 0.02 * torch.log10((t / 1e-3).round() * 1e-3 / 0.1)
    torch.testing.assert_close(found, wanted, rtol=0, atol=0.03 * 0.02)


def test_creep_of_nothing_is_the_identity_to_the_last_bit():
    x = wandering(2, 300)
    assert torch.equal(Creep(1e-4, 0.0)(x)[0], x)


def test_creep_serves_any_sample_rate():
    coarse = wandering(1, 200)
    steps = torch.arange(199 * 10 + 1)
    before, after = coarse[:, steps // 10], coarse[:, (steps // 10 + 1).clamp(max=199)]
    slow, _ = Creep(1e-2, 0.015)(coarse)
    fast, _ = Creep(1e-3, 0.015)(before + (steps % 10) / 10 * (after - before))
    torch.testing.assert_close(fast[:, ::10], slow, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"per_decade": math.inf}, "per_decade: found inf, want -0.5 to 0.5"),
        ({"per_decade": 0.01, "from_s": 0.0}, "from_s: found 0 s, want a positive number of s"),
        ({"per_decade": 0.01, "from_s": 2.0, "to_s": 1.0}, "to_s: found 1 s, want more than from_s = 2 s"),
    ],
)
def test_unphysical_creep_is_refused(arguments, message):
    with pytest.raises(StageError, match=message):
        Creep(1e-4, **arguments)
