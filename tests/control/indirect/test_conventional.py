"""Krejčí–Kuhnen: the exact inverse of the rate-independent operator."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.control.indirect.laws import DeployedLaws
from torchpi.control.indirect import ConventionalInverse, conventional_inverse
from torchpi.errors import ConfigError
from torchpi.operators import PrandtlIshlinskii
from torchpi.operators.chain import Chain
from torchpi.operators.conformance import wandering
from torchpi.operators.dead_zone import DeadZones
from torchpi.operators.motion import Motion

R, W = [0.0, 0.4, 1.0, 2.5], [0.8, 0.1, 0.15, 0.05]


class TestDeployed(DeployedLaws):
    def compensator(self) -> ConventionalInverse:
        return ConventionalInverse(1e-4, R, W, saturation=DeadZones([0.0, 2.0], [1.0, -0.1]), preview=2)


@given(
    st.lists(st.floats(0.05, 2.0), min_size=4, max_size=4),
    st.lists(st.floats(0.0, 1.5), min_size=3, max_size=3),
)
def test_it_is_a_two_sided_inverse_of_any_operator_with_positive_weights(
    weights: list[float], distances: list[float]
) -> None:
    r = torch.tensor([0.0, *distances], dtype=torch.float64).cumsum(0).tolist()
    operator, x = PrandtlIshlinskii(r, weights), 3 * wandering(1, 800)
    inverse = conventional_inverse(operator)
    assert torch.allclose(inverse(operator(x)[0])[0], x, rtol=0, atol=1e-10)
    assert torch.allclose(operator(inverse(x)[0])[0], x, rtol=0, atol=1e-10)
    again = conventional_inverse(inverse)
    assert torch.allclose(again.w, operator.w, rtol=1e-9, atol=1e-9)


def test_the_inverse_operator_has_the_weights_of_the_compensator() -> None:
    inverse, compensator = conventional_inverse(PrandtlIshlinskii(R, W)), ConventionalInverse(1e-4, R, W)
    assert inverse.w.tolist() == compensator.inverse_weights


def test_with_dead_zones_it_inverts_the_modified_operator(motion: Motion) -> None:
    zones = DeadZones([0.0, 1.5, 3.0], [1.0, -0.2, 0.1])
    forward = Chain(plays=PrandtlIshlinskii(R, W), saturation=zones)
    u = ConventionalInverse(1e-4, R, W, saturation=zones, min_voltage_v=-50, max_voltage_v=50)(motion)
    assert torch.allclose(forward(u)[0], motion.yd, rtol=0, atol=1e-12)


def test_the_output_does_not_depend_on_the_rate(motion: Motion) -> None:
    compensator = ConventionalInverse(1e-4, R, W)
    still = Motion(motion.yd, torch.zeros_like(motion.yd), torch.zeros_like(motion.yd))
    assert torch.equal(compensator(motion), compensator(still))


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"thresholds": [0.1, 1.0, 2.0, 3.0]}, "thresholds.*rise from 0"),
        ({"thresholds": [0.0, 2.0, 1.0, 3.0]}, "thresholds.*rise from 0"),
        ({"thresholds": []}, "thresholds"),
        ({"weights": [1.0, 1.0]}, "weights.*expected 4"),
        ({"weights": [1.0, -0.5, -0.6, 2.0]}, "weights.*numbers 0 to 2.*-0.1"),
        ({"weights": [1.0, float("nan"), 1.0, 1.0]}, "weights"),
        ({"sample_period_s": 0.0}, "sample_period_s"),
        ({"preview": -1}, "preview"),
        ({"min_voltage_v": 10.0}, "min_voltage_v"),
        ({"saturation": DeadZones([0.0, 1.0], [1.0, -2.0])}, "no inverse"),
    ],
)
def test_invalid_or_non_invertible_parameters_are_named_in_the_error(changed: dict, named: str) -> None:
    with pytest.raises(ConfigError, match=named) as refusal:
        ConventionalInverse(**{"sample_period_s": 1e-4, "thresholds": R, "weights": W, **changed})
    assert "\n" not in str(refusal.value)
