"""The Prandtl–Ishlinskii sum, eq. 3: forward operator, inverse, monotonicity."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.errors import ConfigError
from torchpi.operators import PrandtlIshlinskii
from torchpi.operators.conformance import HysteresisLaws, wandering


class TestPrandtlIshlinskii(HysteresisLaws):
    def operator(self) -> PrandtlIshlinskii:
        return PrandtlIshlinskii([0.05, 0.3, 0.8, 1.5], [1.0, -0.4, 0.3, -0.1], trainable_thresholds=True)


def test_the_inverse_of_fig_3_undoes_its_forward_operator_exactly() -> None:
    # Checklist: Fig. 3 is the conventional inverse of r = [0 1 2 3 4], all weights 0.1.
    forward = PrandtlIshlinskii([0.0, 1.0, 2.0, 3.0, 4.0], [0.1] * 5)
    fig3 = PrandtlIshlinskii([0.0, 0.1, 0.3, 0.6, 1.0], [10.0, -5.0, -5 / 3, -5 / 6, -0.5])
    x = 3 * wandering(1, 2000)
    assert (fig3(forward(x)[0])[0] - x).abs().max() < 1e-12
    assert (forward(fig3(x)[0])[0] - x).abs().max() < 1e-12


@given(st.lists(st.floats(0.01, 2), min_size=3, max_size=3))
def test_positive_weights_preserve_the_order_of_inputs(weights: list[float]) -> None:
    operator = PrandtlIshlinskii([0.0, 0.4, 1.1], weights)
    x = wandering(1, 300)
    assert bool((operator(x + 0.2)[0] >= operator(x)[0] - 1e-12).all())
    assert bool(((operator(x)[0].diff() * x.diff()) >= -1e-12).all())


def test_the_output_is_the_weighted_sum_of_the_plays_as_in_eq_3() -> None:
    operator = PrandtlIshlinskii([0.0, 0.4, 1.1], [1.0, -0.5, 0.25])
    x = wandering(2, 100)
    h, _ = operator.plays(x)
    assert torch.allclose(operator(x)[0], h @ operator.w, rtol=0, atol=1e-14)


def test_a_wrong_number_of_weights_is_refused() -> None:
    with pytest.raises(ConfigError, match="weights: found 1, expected 2"):
        PrandtlIshlinskii([0.0, 1.0], [1.0])
