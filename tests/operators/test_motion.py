"""Rates from past samples: batch and stream agree, and do not lag."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.operators.motion import BackwardMotionStream, backward_motion


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=30))
def test_stream_gives_the_same_bits_as_the_batch(samples: list[float]) -> None:
    yd = torch.tensor([samples], dtype=torch.float64)
    stream = BackwardMotionStream(1e-4)
    streamed = torch.tensor([stream.step(sample) for sample in samples], dtype=torch.float64)
    assert torch.equal(torch.stack(backward_motion(yd, 1e-4), -1)[0], streamed)


def test_parabola_has_its_exact_rate_and_acceleration() -> None:
    t = 1e-3 * torch.arange(50, dtype=torch.float64)
    motion = backward_motion((3 * t + 5 * t**2)[None], 1e-3)
    assert motion.yd_dot[0, 5:] == pytest.approx((3 + 10 * t)[5:].numpy(), rel=1e-9)
    assert motion.yd_ddot[0, 5:] == pytest.approx(10.0, rel=1e-6)


def test_a_trajectory_at_rest_has_zero_rate_at_any_displacement() -> None:
    motion = backward_motion(torch.full((1, 10), 4.2, dtype=torch.float64), 1e-4)
    assert motion.yd_dot.abs().max() == 0 and motion.yd_ddot.abs().max() == 0
