"""Generalised plays: envelopes and thresholds that differ between rising and falling inputs."""

from typing import Any

import pytest
import torch
from torch import Tensor, nn

from torchpi.errors import ConfigError
from torchpi.operators import Operator, PlayBank, Polynomial, weighted_sum
from torchpi.operators.conformance import HysteresisLaws, OperatorLaws, wandering
from torchpi.operators.generalised_play import (
    GeneralisedPlayBank,
    clamp_bank,
)

W = torch.tensor([1.0, -0.4, 0.3], dtype=torch.float64)


def bank() -> GeneralisedPlayBank:
    return GeneralisedPlayBank(
        [0.05, 0.4, 0.9], [0.1, 0.5, 0.7], [1.0, 0.02, 0.01], [1.05, 0.03, 0.012], 2.0, True
    )


class TestBank(OperatorLaws):
    def operator(self) -> GeneralisedPlayBank:
        return bank()


class Weighted(Operator):
    """The weighted sum of the bank: one signal, as the laws of hysteresis require."""

    def __init__(self) -> None:
        super().__init__()
        self.plays = bank()

    def initial_state(self, batch: int) -> Tensor:
        return self.plays.initial_state(batch)

    def forward(self, x: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        h, state = self.plays(x, state)
        return weighted_sum(h, torch.ones_like(x)[..., None], W[:, None].to(x.dtype)), state

    def stream(self) -> nn.Module:
        return WeightedStream(self.plays.stream())


class WeightedStream(nn.Module):
    w: list[float]

    def __init__(self, plays: Any) -> None:
        super().__init__()
        self.plays = plays
        self.w = W.tolist()

    @torch.jit.export
    def reset(self) -> None:
        self.plays.reset()

    @torch.jit.export
    def step(self, x: float) -> float:
        h: list[float] = self.plays.step(x)
        total = 0.0
        for i in range(len(h)):
            total += self.w[i] * h[i]
        return total


class TestWeighted(HysteresisLaws):
    def operator(self) -> Weighted:
        return Weighted()


def test_equal_envelopes_and_thresholds_give_the_play_of_eq_1_after_the_polynomial() -> None:
    c, r, x = [1.0, -0.1, 0.02], [0.0, 0.3, 1.0], wandering(2, 400)
    expected, _ = PlayBank(r)(Polynomial(c)(x)[0])
    assert torch.equal(GeneralisedPlayBank(r, r, c, c)(x)[0], expected)


def test_the_loop_follows_its_two_envelopes() -> None:
    operator = bank()
    down = torch.linspace(3, -3, 601, dtype=torch.float64)
    x = torch.cat([-down, down, -down])[None]
    h = operator(x)[0][0]
    up, falling = h[1202 + 300 :], h[601 + 300 : 1202]
    assert torch.allclose(up, operator.up(x)[0][0, 1502:, None] - operator.r_up, rtol=0, atol=1e-14)
    assert torch.allclose(
        falling, operator.down(x)[0][0, 901:1202, None] + operator.r_down, rtol=0, atol=1e-14
    )


def test_gradients_are_exact_for_independently_moving_ends() -> None:
    low = torch.randn(2, 20, 3, dtype=torch.float64, requires_grad=True)
    wide = torch.rand(2, 20, 3, dtype=torch.float64, requires_grad=True)
    h0 = torch.randn(2, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda low, wide, h0: clamp_bank(low, low + wide, h0), (low, wide, h0))


def test_the_widths_tell_where_its_envelopes_cross() -> None:
    x = torch.tensor([0.0, 1.0, 3.0], dtype=torch.float64)
    widths = GeneralisedPlayBank([0.5], [0.5], [1.0, 0.5], [1.0]).widths(x)
    assert torch.allclose(widths, 1.0 - 0.5 * x**2)


@pytest.mark.parametrize(
    ("up", "down", "named"),
    [
        ([0.0, 1.0], [0.0], "thresholds_down: found 1, expected 2"),
        ([-1.0], [0.0], "thresholds_up"),
        ([0.0], [float("nan")], "thresholds_down"),
        ([], [], "thresholds_up"),
    ],
)
def test_invalid_thresholds_are_named_in_the_error(up: list, down: list, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        GeneralisedPlayBank(up, down, [1.0], [1.0])
