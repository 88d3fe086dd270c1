"""An inverse that runs backwards within the recorded range is detected and reported."""

import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification.monotone import monotone
from torchpi.operators.motion import backward_motion


def compensator(weights: list[list[float]]) -> DirectInverse:
    made = DirectInverse(1e-3, [0.0, 0.5, 1.0], degree=2, min_voltage_v=-50, max_voltage_v=50)
    with torch.no_grad():
        made.weights.theta.copy_(torch.tensor(weights))
    return made


def test_positive_weight_sums_pass_and_the_voltage_rises_with_the_displacement() -> None:
    made = compensator([[1.0, 0.0], [-0.4, 0.0], [-0.3, 0.0]])
    found = monotone(made, (0.0, 4.0), (-10.0, 10.0))
    assert found and "never runs backwards" in str(found)
    assert abs(found.least_weight_sum - 0.3) < 1e-6
    rising = torch.linspace(0, 4, 200, dtype=torch.float64)[None]
    assert bool((made(backward_motion(rising, 1e-3)).diff() >= 0).all())


def test_a_negative_weight_sum_is_reported_with_its_rate() -> None:
    found = monotone(compensator([[1.0, 0.0], [-0.4, -0.1], [-0.3, 0.0]]), (0.0, 4.0), (-10.0, 10.0))
    assert not found and found.at_rate_um_s == 10.0
    assert "runs backwards" in str(found) and "10 µm/s" in str(found)


def test_a_decreasing_output_function_is_detected() -> None:
    made = DirectInverse(1e-3, [0.0, 0.5], degree=1, output_degree=2, range_um=4.0)
    with torch.no_grad():
        made.weights.theta[:, 0] = torch.tensor([1.0, 0.0])
        made.psi[:, 0] = torch.tensor([-0.4, 0.0])  # g = h - 0.1 h², which decreases from h = 5
    assert monotone(made, (0.0, 4.9), (-1.0, 1.0))
    assert not monotone(made, (0.0, 5.1), (-1.0, 1.0))


def test_a_decreasing_polynomial_is_reported_with_its_location() -> None:
    made = compensator([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    made.saturation.set_coefficients(torch.tensor([1.0, -0.2], dtype=torch.float64))
    found = monotone(made, (0.0, 4.0), (-1.0, 1.0))
    assert not found and found.at_um == 4.0
