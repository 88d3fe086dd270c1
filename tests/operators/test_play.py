"""The play operator: eq. 1, eq. 2, its gradients and its other forms."""

from typing import Any

import control
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from torchpi.errors import ConfigError
from torchpi.operators import Operator, PlayBank, Polynomial, PrandtlIshlinskii, play, play_bank
from torchpi.operators.conformance import HysteresisLaws, wandering
from torchpi.operators.play_scan import play_scan


class TestPlayBank(HysteresisLaws):
    def operator(self) -> PlayBank:
        return PlayBank([0.0, 0.1, 0.45, 1.3], trainable=True)

    def test_gradients_are_those_of_finite_differences(self) -> None:
        # A threshold of exactly 0 stays 0, so finite differences there would see a kink of `relu`.
        operator = PlayBank([0.07, 0.1, 0.45, 1.3], trainable=True)
        self.operator = lambda: operator
        super().test_gradients_are_those_of_finite_differences()


@given(
    x=st.lists(st.floats(-5, 5), min_size=1, max_size=40),
    r=st.floats(0, 3),
    h0=st.floats(-5, 5),
)
def test_play_matches_the_backlash_of_python_control(x: list[float], r: float, h0: float) -> None:
    oracle = control.friction_backlash_nonlinearity(2 * r)
    oracle.center = h0
    h = h0
    for sample in x:
        h = play(sample, r, h)
        assert h == pytest.approx(oracle(sample), abs=1e-12)


def test_the_first_sample_uses_the_initial_state_as_in_eq_2() -> None:
    x = torch.tensor([[0.3, 0.4]], dtype=torch.float64)
    h = play_bank(
        x, torch.tensor([0.1, 1.0], dtype=torch.float64), torch.tensor([[0.0, 0.5]], dtype=torch.float64)
    )
    assert h[0, 0].tolist() == [max(0.3 - 0.1, min(0.3 + 0.1, 0.0)), 0.5]


def test_zero_threshold_copies_the_input_and_passes_gradient_one_everywhere() -> None:
    # Loading, a hold, unloading: a clamp with equal ends would pass no gradient.
    x = torch.tensor([[0.0, 1.0, 2.0, 2.0, 1.5, 1.5, 3.0]], dtype=torch.float64, requires_grad=True)
    h, _ = PlayBank([0.0])(x)
    assert torch.equal(h[..., 0], x)
    h.sum().backward()
    assert torch.equal(x.grad, torch.ones_like(x))


@given(seed=st.integers(0, 10**6), time=st.integers(1, 200), plays=st.integers(1, 6))
def test_scan_gives_the_same_bits_and_gradients_as_the_kernel(seed: int, time: int, plays: int) -> None:
    generator = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=generator)

    # Rounded inputs and thresholds hit the kinks exactly.
    x = (2 * random(2, time)).round(decimals=1).requires_grad_()
    r = random(plays).abs().round(decimals=1).requires_grad_()
    h0 = random(2, plays).round(decimals=1).requires_grad_()
    upstream = random(2, time, plays)
    kernel, scan = play_bank(x, r, h0), play_scan(x, r, h0)
    assert torch.equal(kernel, scan)
    for one, other in zip(
        torch.autograd.grad(kernel, (x, r, h0), upstream),
        torch.autograd.grad(scan, (x, r, h0), upstream),
        strict=True,
    ):
        assert torch.allclose(one, other, rtol=0, atol=1e-10)


@pytest.mark.parametrize("form", [play_bank, play_scan])
def test_at_a_kink_the_gradient_is_one_of_the_one_sided_derivatives(form: object) -> None:
    # The play is exactly at its edge: the sample may push it or not, but must do one of the two entirely.
    x = torch.tensor([[1.0, 1.0]], dtype=torch.float64, requires_grad=True)
    r = torch.tensor([0.4], dtype=torch.float64, requires_grad=True)
    h = form(x, r, torch.zeros(1, 1, dtype=torch.float64))
    gx, gr = torch.autograd.grad(h[0, 1, 0], (x, r))
    assert sorted(gx[0].tolist()) == [0.0, 1.0]
    assert gr.tolist() == [-1.0]


def test_float32_is_kept() -> None:
    h, state = PlayBank([0.0, 0.2])(wandering(1, 30).float())
    assert h.dtype == state.dtype == torch.float32


def test_a_zero_threshold_has_no_gradient_in_training_and_others_have_one() -> None:
    bank = PlayBank([0.0, 0.5], trainable=True)
    h, _ = bank(wandering(1, 100))
    h.square().sum().backward()
    gradient = bank.raw_thresholds.grad
    assert gradient is not None and gradient[0] == 0 and gradient[1] != 0


@pytest.mark.parametrize("thresholds", [[], [-0.1], [float("nan")], [float("inf")], "abc", None, ["a"]])
def test_invalid_thresholds_are_named_in_the_error(thresholds: Any) -> None:
    with pytest.raises(ConfigError, match="thresholds: found"):
        PlayBank(thresholds)


@pytest.mark.parametrize(
    "operator", [PlayBank([0.0, 0.5]), PrandtlIshlinskii([0.5], [2.0]), Polynomial([0.5])]
)
@pytest.mark.parametrize(
    ("x", "found"),
    [
        (torch.arange(6).reshape(1, 6), "torch.int64, expected floating-point numbers"),
        (np.zeros((1, 6)), r"ndarray, expected a tensor \(batch, time\)"),
        ("abc", r"str, expected a tensor \(batch, time\)"),
        (torch.zeros(6), r"shape \(6,\), expected \(batch, time\)"),
        (torch.zeros(1, 6, 2), r"shape \(1, 6, 2\), expected \(batch, time\)"),
    ],
    ids=["integers", "array", "word", "one record", "three dimensions"],
)
def test_an_input_that_is_not_a_batch_of_records_is_refused(operator: Operator, x: Any, found: str) -> None:
    with pytest.raises(ConfigError, match=f"x: found {found}"):
        operator(x)


def test_states_match_those_of_a_plain_loop() -> None:
    x, r = wandering(1, 500), np.array([0.0, 0.3, 0.9])
    h = np.zeros(3)
    expected = []
    for sample in x[0].numpy():
        h = np.maximum(sample - r, np.minimum(sample + r, h))
        expected.append(h)
    assert np.array_equal(PlayBank(r.tolist())(x)[0][0].numpy(), np.array(expected))
