"""Weights that follow the rate: eq. 7 and its neural extension."""

import pytest
import torch

from torchpi.errors import ConfigError
from torchpi.operators import RateWeights, weighted_sum


def test_linear_head_is_eq_7_with_the_signed_rate() -> None:
    head = RateWeights([1.0, -0.5], "linear", rate_scale_um_s=200.0)
    with torch.no_grad():
        head.theta[:, 1] = torch.tensor([0.3, 0.1])
    rate = torch.tensor([[-400.0, 0.0, 400.0]], dtype=torch.float64)
    expected = head.k * rate[..., None] + head.b
    assert torch.allclose(head(rate), expected, rtol=1e-12)
    assert head(rate)[0, 0, 0] != head(rate)[0, 2, 0]


def test_neural_head_starts_as_the_linear_one() -> None:
    rate = torch.linspace(-900, 900, 31, dtype=torch.float64)[None]
    linear, neural = (RateWeights([1.0, 2.0], kind, 300.0) for kind in ("linear", "neural"))
    assert torch.allclose(linear(rate), neural(rate), rtol=0, atol=1e-15)


def test_gradients_to_every_parameter_of_the_neural_head_are_exact() -> None:
    head = RateWeights([1.0, -0.5], "neural", 200.0, hidden=3)
    torch.nn.init.normal_(head.theta)
    h = torch.randn(1, 9, 2, dtype=torch.float64, requires_grad=True)
    rate = (300 * torch.randn(1, 9, dtype=torch.float64)).requires_grad_()

    def output(*_: torch.Tensor) -> torch.Tensor:
        return weighted_sum(h, head.basis(rate), head.theta)

    assert torch.autograd.gradcheck(output, (h, rate, *head.parameters()))


def test_output_functions_add_powers_of_the_state_and_pass_exact_gradients() -> None:
    h = torch.randn(2, 7, 3, dtype=torch.float64, requires_grad=True)
    basis = torch.randn(2, 7, 2, dtype=torch.float64, requires_grad=True)
    theta = torch.randn(3, 2, dtype=torch.float64, requires_grad=True)
    psi = torch.randn(3, 2, dtype=torch.float64, requires_grad=True)
    z = h / 2.5
    w = torch.einsum("im,btm->bti", theta, basis) + psi[:, 0] * z + psi[:, 1] * z**2
    assert torch.allclose(weighted_sum(h, basis, theta, psi, 2.5), (w * h).sum(-1), rtol=0, atol=1e-12)
    assert torch.autograd.gradcheck(lambda *x: weighted_sum(*x, 2.5), (h, basis, theta, psi))


def test_weighted_sum_is_eq_8() -> None:
    h = torch.randn(2, 50, 4, dtype=torch.float64)
    basis = torch.randn(2, 50, 3, dtype=torch.float64)
    theta = torch.randn(4, 3, dtype=torch.float64)
    expected = torch.einsum("bti,im,btm->bt", h, theta, basis)
    assert torch.allclose(weighted_sum(h, basis, theta), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [({"kind": "cubic"}, "rate"), ({"rate_scale_um_s": 0.0}, "rate_scale_um_s"), ({"hidden": 0}, "hidden")],
)
def test_invalid_arguments_are_named_in_the_error(arguments: dict, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        RateWeights([1.0], **arguments)
