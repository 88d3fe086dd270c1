"""Converters: their levels, their gradient, their range."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.errors import StageError
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.operators.quantization import Converter


class TestLaws(OperatorLaws):
    differentiable = False  # its gradient is that of the line through the steps, not its own

    def operator(self) -> Converter:
        return Converter(5, -1.5, 1.5)


@given(x=st.floats(-10, 9.999), bits=st.integers(1, 24))
def test_a_converter_errs_by_at_most_half_a_step_and_keeps_its_own_levels(x, bits):
    converter = Converter(bits, -10.0, 10.0)
    (once,), _ = converter(torch.tensor([[x]], dtype=torch.float64))
    step = 20.0 / 2**bits
    top = 10.0 - step
    assert abs(once.item() - min(x, top)) <= step / 2 * (1 + 1e-9)
    assert torch.equal(converter(once[None])[0][0], once)
    assert (once.item() + 10.0) / step == round((once.item() + 10.0) / step)


def test_a_converter_passes_the_gradient_straight_through_only_within_its_range():
    x = torch.tensor([[-11.0, -3.3, 0.1, 9.0, 11.0]], dtype=torch.float64, requires_grad=True)
    Converter(8, -10.0, 10.0)(x)[0].sum().backward()
    assert x.grad.tolist() == [[0.0, 1.0, 1.0, 1.0, 0.0]]


def test_the_error_of_a_fine_converter_has_the_spread_of_a_uniform_one():
    x = wandering(1, 5000)
    converter = Converter(12, -4.0, 4.0)
    error = converter(x)[0] - x
    assert error.std().item() == pytest.approx(converter.step_size / math.sqrt(12), rel=0.05)


def test_a_range_out_of_order_or_zero_bits_are_refused():
    with pytest.raises(StageError, match="high: found 1, expected a finite number above low = 2"):
        Converter(16, 2.0, 1.0)
    with pytest.raises(StageError, match="bits: found 0 bits, expected 1 to 32 bits"):
        Converter(0, 0.0, 1.0)
