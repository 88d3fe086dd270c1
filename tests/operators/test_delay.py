"""A delay moves a signal by its time, whole samples and fractions."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.errors import StageError
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.operators.delay import Delay


class TestLaws(OperatorLaws):
    def operator(self) -> Delay:
        return Delay(sample_period_s=0.1, delay_s=0.237)


@given(samples=st.integers(0, 25))
def test_whole_samples_are_a_shift(samples):
    x = wandering(2, 60)
    y, _ = Delay(0.5, 0.5 * samples)(x)
    assert torch.equal(y[:, samples:], x[:, : 60 - samples]) and bool((y[:, :samples] == 0).all())


@given(samples=st.floats(0, 20))
def test_a_ramp_comes_out_later_by_exactly_the_delay(samples):
    t = 0.25 * torch.arange(60, dtype=torch.float64)[None]
    y, _ = Delay(0.25, 0.25 * samples, longest_delay_s=6.0)(t)
    torch.testing.assert_close(y, (t - 0.25 * samples).clamp(min=0), rtol=0, atol=1e-9)


def test_no_delay_is_the_identity_to_the_last_bit_and_has_a_gradient():
    delay, x = Delay(0.1, 0.0), wandering(1, 50)
    y, _ = delay(x)
    assert torch.equal(y, x)
    y[0, 20].backward()
    assert delay.delay_s.grad.item() == pytest.approx(-(x[0, 20] - x[0, 19]).item() / 0.1)


def test_windows_may_be_shorter_than_the_delay():
    delay, x = Delay(0.1, 1.23), wandering(1, 60)
    state, ys = None, []
    for t in range(60):
        y, state = delay(x[:, t : t + 1], state)
        ys.append(y)
    assert torch.equal(torch.cat(ys, 1), delay(x)[0])


def test_a_delay_that_left_its_range_is_refused():
    with pytest.raises(StageError, match=r"delay_s: found -0.1 s, want at least 0 s"):
        Delay(0.1, -0.1)
    with pytest.raises(StageError, match="delay_s: found 2 s, want 0 to longest_delay_s = 1 s"):
        Delay(0.1, 2.0, longest_delay_s=1.0)
    delay = Delay(0.1, 0.1)
    with torch.no_grad():
        delay.delay_s -= 0.2
    with pytest.raises(StageError, match=r"delay_s: found -0.1 s"):
        delay(wandering(1, 5))
