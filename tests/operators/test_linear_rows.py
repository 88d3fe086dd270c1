"""Rows that are computed together have the same bits as each row alone."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.operators.linear import state_space


@given(rows=st.integers(1, 20), order=st.integers(1, 4), seed=st.integers(0, 10**6))
@pytest.mark.parametrize("learns", [False, True])
def test_every_row_of_a_batch_has_the_same_bits_as_alone(learns, rows, order, seed):
    random = np.random.default_rng(seed)
    shapes = ((rows, 40), (order, order), (order,), (order,), (), (rows, order))
    u, a, b, c, d, x0 = (torch.tensor(random.normal(size=shape) / 2) for shape in shapes)
    matrices = [part.requires_grad_(learns) for part in (a, b, c, d)]
    y, x = state_space(u, *matrices, x0)
    y.sum().backward() if learns else None
    together = [part.grad for part in matrices]
    for part in matrices:
        part.grad = None
    for row in range(rows):
        alone, end = state_space(u[row : row + 1], *matrices, x0[row : row + 1])
        assert torch.equal(alone[0], y[row]) and torch.equal(end[0], x[row])
        alone.sum().backward() if learns else None
    for part, whole in zip(matrices, together, strict=True):
        if learns:
            torch.testing.assert_close(part.grad, whole, rtol=1e-9, atol=1e-9)
