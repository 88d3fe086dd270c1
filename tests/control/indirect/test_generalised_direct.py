"""The direct inverse with generalised plays."""

import pytest
import torch

from tests.control.indirect.laws import DeployedLaws
from torchpi.control.direct_inverse import DirectInverse
from torchpi.control.indirect import GeneralisedDirectInverse
from torchpi.errors import ConfigError
from torchpi.operators.generalised_play import GeneralisedPlayBank
from torchpi.operators.motion import Motion

R, K, B = [0.0, 0.3, 1.0], [1e-5, -2e-5, 1e-5], [1.2, -0.2, -0.1]


class TestDeployed(DeployedLaws):
    def compensator(self) -> GeneralisedDirectInverse:
        plays = GeneralisedPlayBank(R, [0.0, 0.4, 0.8], [1.0, -0.02], [1.01, -0.01], 8.0)
        return GeneralisedDirectInverse(1e-4, plays, K, B, preview=1)


def test_with_equal_envelopes_and_thresholds_it_is_eq_8(motion: Motion) -> None:
    c = [1.1, -0.02, 0.003]
    paper = DirectInverse(1e-4, R, degree=3)
    paper.saturation.set_coefficients(torch.tensor(c, dtype=torch.float64))
    with torch.no_grad():
        paper.weights.theta[:, 0] = torch.tensor(B)
        paper.weights.theta[:, 1] = torch.tensor(K)
    general = GeneralisedDirectInverse(1e-4, GeneralisedPlayBank(R, R, c, c), K, B)
    assert torch.allclose(general(motion), paper(motion), rtol=0, atol=1e-6)


def test_gradients_reach_every_parameter(motion: Motion) -> None:
    plays = GeneralisedPlayBank(R, R, [1.0, 0.1], [1.0, 0.1], trainable_thresholds=True)
    compensator = GeneralisedDirectInverse(1e-4, plays, K, B)
    compensator.voltage(motion)[0].square().sum().backward()
    assert all(
        parameter.grad is not None and bool(parameter.grad.any()) for parameter in compensator.parameters()
    )


@pytest.mark.parametrize(
    ("k", "b", "named"),
    [(K[:2], B, "slopes: found 2, expected 3"), (K, B[:1], "offsets: found 1, expected 3")],
)
def test_a_wrong_number_of_weights_is_refused(k: list[float], b: list[float], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        GeneralisedDirectInverse(1e-4, GeneralisedPlayBank(R, R, [1.0], [1.0]), k, b)
