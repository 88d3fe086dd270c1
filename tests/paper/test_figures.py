"""Fig. 3, 4, 5 and 8 as numbers."""

import numpy as np
import pytest
import torch

from torchpi.control.indirect import conventional_inverse
from torchpi.operators import Polynomial
from torchpi.paper import fig3, fig4, fig5, fig8


def test_the_inverse_of_fig_3_undoes_its_forward_operator() -> None:
    assert fig3.round_trip() < 1e-12


def test_fig_3_is_the_conventional_inverse_of_its_forward_operator() -> None:
    inverse = conventional_inverse(fig3.forward())
    assert inverse.plays.r.tolist() == pytest.approx(fig3.THRESHOLDS, abs=1e-15)
    assert inverse.w.tolist() == pytest.approx(fig3.WEIGHTS, rel=1e-12)


def test_in_fig_4_the_polynomial_needs_fewer_parameters_and_is_smooth() -> None:
    figure = fig4.fig4()
    assert (figure.cubic_numbers, figure.dead_zone_numbers) == (3, 11)
    assert 0.05 < figure.max_percent < 1.0
    assert figure.slope_jump_percent > 1.0
    kinks = np.count_nonzero(np.abs(np.diff(figure.dead_zones, 2)) > 1e-9)
    assert 5 <= kinks <= 10  # five thresholds, each between two samples or on one


def test_eq_5_has_the_expected_values() -> None:
    s = Polynomial(fig5.POLYNOMIAL)
    x = torch.tensor([[1.0, -2.0, 10.0]], dtype=torch.float64)
    expected = [1e-4 + 2e-3 + 0.5, -(1e-4 * 32 + 2e-3 * 8 + 1.0), 17.0]
    assert s(x)[0][0].tolist() == pytest.approx(expected, rel=1e-12)


def test_in_fig_5_the_polynomial_makes_the_ends_of_the_loop_steep() -> None:
    assert fig5.end_slope_ratio() > 5
    x, u = fig5.loop()
    _, without = fig5.loop(with_polynomial=False)
    assert u[0] == pytest.approx(u[-1], abs=1e-12)
    assert np.abs(u + np.roll(u[:-1], len(u) // 2)[np.r_[: len(u) - 1, 0]]).max() < 1e-9  # odd symmetry
    top = x > 0.97 * x.max()
    assert np.ptp(u[top]) > 3 * np.ptp(without[top])


@pytest.mark.parametrize(("frequency_hz", "percent"), [(5, 0.26), (10, 0.56), (50, 4.2), (100, 11.6)])
def test_fig_8_has_the_expected_errors(frequency_hz: float, percent: float) -> None:
    figure = fig8.indirect(frequency_hz)
    assert figure.max_percent == pytest.approx(percent, rel=0.1)
    assert figure.max_percent == pytest.approx(
        100 * np.abs(figure.y - figure.yd).max() / fig8.PEAK_TO_PEAK_UM, rel=1e-9
    )
