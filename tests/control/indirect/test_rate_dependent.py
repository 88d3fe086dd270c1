"""Ang and Tan: the closed-form inverse with rate-dependent terms inserted."""

import numpy as np
import pytest
import torch

from tests.control.indirect.laws import DeployedLaws
from torchpi.control.indirect import ConventionalInverse, RateDependentInverse
from torchpi.control.indirect.base import LEAST_SLOPE
from torchpi.control.indirect.inversion_law import inverse_numbers
from torchpi.errors import ConfigError
from torchpi.operators.motion import Motion
from torchpi.operators.rate_dependent_pi import RateDependentPI
from torchpi.paper.fig7_plant import OFFSETS, SLOPES, THRESHOLDS
from torchpi.paper.fig8 import fig8_inverse, indirect


class TestDeployed(DeployedLaws):
    def compensator(self) -> RateDependentInverse:
        return RateDependentInverse(1e-4, THRESHOLDS, OFFSETS, weight_slopes=SLOPES, preview=1)


def test_without_slopes_it_is_the_conventional_inverse(motion: Motion) -> None:
    none = [0.0] * len(OFFSETS)
    rate_dependent = RateDependentInverse(1e-4, THRESHOLDS, OFFSETS, weight_slopes=none)
    assert torch.equal(rate_dependent(motion), ConventionalInverse(1e-4, THRESHOLDS, OFFSETS)(motion))


def test_at_each_sample_it_is_the_closed_form_for_the_weights_at_that_rate() -> None:
    """The law is written out in numpy, with new thresholds and weights at every sample."""
    t = np.arange(600) * 1e-4
    yd = 5.5 - 4.5 * np.cos(2 * np.pi * 40 * t)
    rate = 4.5 * 2 * np.pi * 40 * np.sin(2 * np.pi * 40 * t)
    expected, h = [], np.zeros(10)
    for y, v in zip(yd, rate, strict=True):
        r, w = map(np.array, inverse_numbers(THRESHOLDS, np.array(SLOPES) * v + OFFSETS))
        h = np.maximum(y - r, np.minimum(y + r, h))
        expected.append(w @ h)
    motion = Motion(*(torch.from_numpy(part)[None] for part in (yd, rate, np.zeros_like(yd))))
    np.testing.assert_allclose(fig8_inverse()(motion)[0].numpy(), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("frequency_hz", "percent"), [(5, 0.26), (10, 0.56), (50, 4.2), (100, 11.6)])
def test_fig_8_has_the_errors_of_the_checklist(frequency_hz: float, percent: float) -> None:
    assert indirect(frequency_hz).max_percent == pytest.approx(percent, rel=0.1)


def test_the_error_of_fig_8_is_steady_in_the_last_cycle() -> None:
    assert indirect(50, cycles=3).max_percent == pytest.approx(indirect(50, cycles=6).max_percent, rel=1e-9)


def test_it_is_not_an_exact_inverse_but_approaches_it_for_slow_motion() -> None:
    """The error falls at least in proportion to the rate."""
    errors = [indirect(f, cycles=2, sample_period_s=1e-4 * 5 / f).max_percent for f in (0.05, 0.5, 5)]
    assert errors[0] < errors[1] / 9 < errors[2] / 80


def test_a_rate_at_which_the_model_has_no_inverse_is_clipped_to_the_last_with_one() -> None:
    inverse = fig8_inverse()
    slowest, fastest = inverse.rates_um_s
    sums = np.cumsum(OFFSETS), np.cumsum(SLOPES)
    for rate in (max(slowest, -1e6), min(fastest, 1e6)):
        assert (sums[0] + sums[1] * rate >= (LEAST_SLOPE - 1e-12) * sums[0]).all()
    assert fastest == pytest.approx(0.95 * 0.77 / 2e-4)
    y = torch.linspace(0, 5, 50, dtype=torch.float64)[None]
    beyond, at = (Motion(y, torch.full_like(y, rate), y) for rate in (2 * fastest, fastest))
    assert torch.equal(inverse(beyond), inverse(at))


def test_at_zero_rate_it_inverts_its_own_model_exactly() -> None:
    """At zero rate, plant and inverse are a Prandtl–Ishlinskii operator and its exact inverse."""
    plant = RateDependentPI(1.0, THRESHOLDS, SLOPES, OFFSETS)
    yd = 5.5 - 4.5 * torch.cos(torch.linspace(0, 20, 4000, dtype=torch.float64))[None]
    zero = torch.zeros_like(yd)
    u = fig8_inverse(1.0)(Motion(yd, zero, zero))
    assert torch.allclose(plant.at_rate(u, zero)[0], yd, rtol=0, atol=1e-12)


def test_a_wrong_number_of_slopes_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"weight_slopes.*expected 10"):
        RateDependentInverse(1e-4, THRESHOLDS, OFFSETS, weight_slopes=SLOPES[:3])
