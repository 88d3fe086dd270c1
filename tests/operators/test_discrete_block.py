"""A block with fixed matrices gives the bits of the differentiable operators."""

import pytest
import torch

from torchpi.operators.discrete_block import DiscreteBlock
from torchpi.operators.linear import state_space
from torchpi.operators.relaxations import relaxations


@pytest.mark.parametrize("rows", [1, 2, 7])
@pytest.mark.parametrize("order", [1, 2, 3, 5])
@pytest.mark.parametrize("diagonal", [False, True])
def test_the_response_has_the_bits_of_the_operator(rows: int, order: int, diagonal: bool) -> None:
    a, b, c = (
        torch.rand(order, order).double() / order,
        torch.rand(order).double(),
        torch.rand(order).double(),
    )
    a, d = (
        (a.diagonal() if diagonal else a.T),
        torch.tensor(0.3, dtype=torch.float64),
    )  # neither is contiguous
    u = torch.randn(rows, 1100, dtype=torch.float64)
    operator = relaxations if diagonal else state_space
    expected, _ = operator(u, a, b, c, d, torch.zeros(rows, order, dtype=torch.float64))
    block, before = DiscreteBlock((a, b, c, d)), u.clone()
    for _ in range(2):  # it keeps no state
        assert (torch.from_numpy(block(u.numpy())) == expected).all()
    assert (u == before).all()
