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
    whole, b, c, d = (torch.rand(size, dtype=torch.float64) for size in ((order, order), order, order, ()))
    a = (whole / order).diagonal() if diagonal else (whole / order).T  # neither is contiguous
    u = torch.randn(rows, 1100, dtype=torch.float64)
    operator = relaxations if diagonal else state_space
    expected, _ = operator(u, a, b, c, d, torch.zeros(rows, order, dtype=torch.float64))
    block, before = DiscreteBlock((a, b, c, d)), u.clone()
    for _ in range(2):  # it keeps no state
        assert (torch.from_numpy(block(u.numpy())) == expected).all()
    assert (u == before).all()
