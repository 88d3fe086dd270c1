"""The diagonal kernel, compared with the dense one, and its derivative."""

import pytest
import torch

from torchpi.operators.conformance import wandering
from torchpi.operators.linear import discretise, state_space
from torchpi.operators.relaxations import relaxation, relaxations


def bank(learning: bool) -> list[torch.Tensor]:
    rows = torch.tensor([[0.9, 0.5, -0.2], [0.1, 0.4, 0.3], [1.0, -0.6, 0.2]], dtype=torch.float64)
    return [part.clone().requires_grad_(learning) for part in (*rows, torch.tensor(0.7, dtype=torch.float64))]


def test_it_equals_the_dense_block_with_a_diagonal_matrix():
    a, b, c, d = bank(False)
    u, x0 = wandering(3, 200), torch.rand(3, 3, dtype=torch.float64)
    found, wanted = relaxations(u, a, b, c, d, x0), state_space(u, torch.diag(a), b, c, d, x0)
    for ours, dense in zip(found, wanted, strict=True):
        torch.testing.assert_close(ours, dense, rtol=1e-13, atol=1e-13)


def test_gradients_to_every_argument_are_exact():
    u, x0 = wandering(2, 9).requires_grad_(), torch.rand(2, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(relaxations, (u, *bank(True), x0))
    assert torch.autograd.gradcheck(lambda u: relaxations(u, *bank(False), x0.detach()), (u,))


@pytest.mark.parametrize("hold", ["end", "first"])
def test_closed_forms_of_lags_agree_with_the_matrix_exponential(hold):
    omega_t = torch.logspace(-9, 3, 49, dtype=torch.float64)
    a, b, d = relaxation(omega_t, hold)
    one = torch.ones_like(omega_t)[:, None]
    dense = discretise(
        -omega_t[:, None, None],
        omega_t[:, None],
        one,
        torch.zeros_like(omega_t),
        sample_period_s=1.0,
        hold=hold,
    )
    torch.testing.assert_close(a, dense[0][:, 0, 0], rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(b, dense[1][:, 0], rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(d, dense[3], rtol=0, atol=1e-15)


@pytest.mark.parametrize("hold", ["end", "first"])
def test_an_infinitely_fast_lag_is_the_identity(hold):
    a, b, d = relaxation(torch.tensor([torch.inf], dtype=torch.float64), hold)
    assert (a.item(), b.item(), d.item()) == (0.0, 0.0, 1.0)
