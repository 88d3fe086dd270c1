"""The forward operator with rate-dependent weights."""

import pytest
import torch

from torchpi.errors import ConfigError
from torchpi.operators import PrandtlIshlinskii
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.operators.motion import backward_motion
from torchpi.operators.rate_dependent_pi import RateDependentPI

T = 1e-2
R, K, B = [0.0, 0.3, 0.8], [2e-3, -1e-3, 5e-4], [1.0, 0.2, 0.1]


class TestRateDependentPI(OperatorLaws):
    def operator(self) -> RateDependentPI:
        return RateDependentPI(T, [0.05, 0.3, 0.8], K, B)


def test_without_slopes_it_is_eq_3() -> None:
    x = wandering(2, 300)
    assert torch.equal(RateDependentPI(T, R, [0.0] * 3, B)(x)[0], PrandtlIshlinskii(R, B)(x)[0])


def test_each_weight_follows_the_signed_rate_of_the_input() -> None:
    operator, x = RateDependentPI(T, R, K, B), wandering(2, 300)
    h, _ = operator.plays(x)
    w = backward_motion(x, T).yd_dot[..., None] * operator.k + operator.b
    assert torch.allclose(operator(x)[0], (w * h).sum(-1), rtol=0, atol=1e-13)


def test_a_known_rate_can_replace_the_backward_difference() -> None:
    operator, x = RateDependentPI(T, R, K, B), wandering(1, 300)
    assert torch.equal(operator.at_rate(x, backward_motion(x, T).yd_dot)[0], operator(x)[0])


def test_a_record_may_begin_at_any_value_without_a_jump_of_the_rate() -> None:
    operator = RateDependentPI(T, R, K, B)
    x = torch.full((1, 5), 3.0, dtype=torch.float64)
    assert torch.allclose(operator(x)[0], PrandtlIshlinskii(R, B)(x)[0], rtol=0, atol=0)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((0.0, R, K, B), "sample_period_s"),
        ((T, [-1.0], [0.0], [1.0]), "thresholds"),
        ((T, R, K[:2], B), "slopes.*expected 3"),
        ((T, R, K, [1.0, 2.0, float("nan")]), "offsets"),
    ],
)
def test_invalid_arguments_are_named_in_the_error(arguments: tuple, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        RateDependentPI(*arguments)
