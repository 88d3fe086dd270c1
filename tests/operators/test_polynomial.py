"""The saturation polynomial, eq. 4, and the paper's numbers for it."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.errors import ConfigError
from torchpi.operators import Polynomial
from torchpi.operators.conformance import OperatorLaws


class TestPolynomial(OperatorLaws):
    def operator(self) -> Polynomial:
        return Polynomial([1.2, -0.3, 0.05, 0.01], scale=2.0)


def test_the_polynomial_of_the_paper_has_the_values_of_the_checklist() -> None:
    s = Polynomial([1.40, -7.62e-2, 1.45e-2, -7.53e-4], scale=8.0)  # eq. 12
    x = torch.linspace(0, 8.1, 811, dtype=torch.float64, requires_grad=True)[None]
    y, _ = s(x)
    (slope,) = torch.autograd.grad(y.sum(), x)
    assert y[0, -1].item() == pytest.approx(10.805, abs=5e-4)
    assert y[0, 405].item() == pytest.approx(5.181, abs=5e-4)
    assert (slope.min().item(), slope.max().item()) == pytest.approx((1.243, 1.434), abs=5e-4)


@given(st.lists(st.floats(-3, 3), min_size=1, max_size=6), st.floats(0.1, 20))
def test_the_scale_does_not_change_the_polynomial(c: list[float], scale: float) -> None:
    x = torch.linspace(-2, 2, 21, dtype=torch.float64)[None]
    expected = np.polynomial.Polynomial([0.0, *c])(x.numpy())
    assert np.allclose(Polynomial(c, scale)(x)[0].detach().numpy(), expected, rtol=1e-9, atol=1e-9)


def test_an_empty_list_of_coefficients_is_refused() -> None:
    with pytest.raises(ConfigError, match="coefficients"):
        Polynomial([])
