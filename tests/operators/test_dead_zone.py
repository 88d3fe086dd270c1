"""One-sided dead zones: Kuhnen's operator, its inverse, and Fig. 4."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.errors import ConfigError
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.operators.dead_zone import DeadZones, dead_zone, fit_dead_zones


class TestDeadZones(OperatorLaws):
    def operator(self) -> DeadZones:
        return DeadZones([-1.0, -0.21, 0.0, 0.33, 0.9], [0.2, -0.3, 1.1, -0.2, 0.4])


def test_each_zone_is_zero_up_to_its_threshold_and_then_follows_the_input() -> None:
    assert [dead_zone(x, 0.5) for x in (-2.0, 0.4, 1.5)] == [0.0, 0.0, 1.0]
    assert [dead_zone(x, -0.5) for x in (-1.5, -0.4, 2.0)] == [-1.0, 0.0, 0.0]
    assert dead_zone(-3.0, 0.0) == -3.0


@given(st.lists(st.floats(0.2, 3.0), min_size=5, max_size=5))
def test_it_is_piecewise_linear_through_its_corners(slopes: list[float]) -> None:
    d = [-2.0, -0.5, 0.0, 1.0, 1.5]
    # Slopes beyond -2, between -2 and -0.5, about 0, between 1 and 1.5, beyond 1.5.
    a, b, c, e, f = slopes
    operator = DeadZones(d, [a - b, b - c, c, e - c, f - e])
    corners = np.array([-3.0, -2.0, -0.5, 0.0, 1.0, 1.5, 4.0])
    heights = np.array([-a - 1.5 * b - 0.5 * c, -1.5 * b - 0.5 * c, -0.5 * c, 0, c, c + 0.5 * e, 0])
    heights[-1] = heights[-2] + 2.5 * f
    x = torch.linspace(-3, 4, 141, dtype=torch.float64)[None]
    assert np.allclose(operator(x)[0][0].detach(), np.interp(x[0], corners, heights), rtol=0, atol=1e-12)
    assert torch.allclose(operator.slopes, torch.tensor(slopes, dtype=torch.float64), rtol=1e-12)


@given(st.lists(st.floats(0.2, 3.0), min_size=5, max_size=5))
def test_the_inverse_undoes_it_and_is_a_dead_zone_operator_too(slopes: list[float]) -> None:
    a, b, c, e, f = slopes
    operator = DeadZones([-2.0, -0.5, 0.0, 1.0, 1.5], [a - b, b - c, c, e - c, f - e])
    inverse, x = operator.inverse(), 3 * wandering(1, 300)
    assert torch.allclose(inverse(operator(x)[0])[0], x, rtol=0, atol=1e-12)
    assert torch.allclose(operator(inverse(x)[0])[0], x, rtol=0, atol=1e-12)
    assert torch.allclose(inverse.inverse().d, operator.d, rtol=0, atol=1e-12)


def test_the_fit_recovers_the_weights_of_a_dead_zone_curve() -> None:
    operator = DeadZones([0.0, 1.0, 2.0], [1.0, -0.4, 0.7])
    x = torch.linspace(0, 3, 300, dtype=torch.float64)
    fitted = fit_dead_zones(x, operator(x[None])[0][0].detach(), [0.0, 1.0, 2.0])
    assert torch.allclose(fitted.w, operator.w, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("thresholds", "weights", "named"),
    [
        ([0.0, 0.0], [1.0, 1.0], "thresholds"),
        ([0.5, 1.0], [1.0, 1.0], "thresholds.*one of them 0"),
        ([0.0, float("nan")], [1.0, 1.0], "thresholds"),
        ([], [], "thresholds"),
        ([0.0, 1.0], [1.0], "weights.*expected 2"),
        ([0.0, 1.0], [1.0, float("inf")], "weights"),
    ],
)
def test_invalid_thresholds_or_weights_are_named_in_the_error(
    thresholds: list, weights: list, named: str
) -> None:
    with pytest.raises(ConfigError, match=named):
        DeadZones(thresholds, weights)


def test_an_operator_with_a_slope_that_is_not_positive_has_no_inverse() -> None:
    with pytest.raises(ConfigError, match="no inverse"):
        DeadZones([0.0, 1.0], [1.0, -1.0]).inverse()
