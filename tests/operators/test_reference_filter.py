"""The reference filter, eq. 14: exact, from rest, for any reference."""

import math
import warnings

import pytest
import torch

from torchpi.errors import ConfigError
from torchpi.operators import ReferenceFilter

OMEGA = 200 * math.pi


def reference(t: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return a reference that starts neither at zero nor at rest, and its two derivatives."""
    return (
        4 + torch.sin(60 * t + 0.3),
        60 * torch.cos(60 * t + 0.3),
        -3600 * torch.sin(60 * t + 0.3),
    )


@pytest.mark.parametrize("period", [1e-3, 1e-4, 3.7e-5])
def test_the_critically_damped_filter_matches_the_closed_form_at_any_sample_rate(period: float) -> None:
    t = period * torch.arange(2000, dtype=torch.float64)
    yr, yr_dot, yr_ddot = (part[None] for part in reference(t))
    motion = ReferenceFilter(period)(yr, yr_dot, yr_ddot)
    start = yr[0, 0] + (yr_dot[0, 0] + OMEGA * yr[0, 0]) * t
    slope = yr_dot[0, 0] + OMEGA * yr[0, 0]
    decay = torch.exp(-OMEGA * t)
    assert torch.allclose(motion.yd, yr - start * decay, rtol=0, atol=1e-11)
    assert torch.allclose(motion.yd_dot, yr_dot - (slope - OMEGA * start) * decay, rtol=0, atol=1e-8)
    assert motion.yd[0, 0] == 0 and motion.yd_dot[0, 0] == 0


def test_a_reference_given_by_samples_agrees_with_the_exact_derivatives() -> None:
    period = 1e-4
    t = period * torch.arange(3000, dtype=torch.float64)
    exact = ReferenceFilter(period)(*(part[None] for part in reference(t)))
    sampled = ReferenceFilter(period)(reference(t)[0][None])
    assert (sampled.yd - exact.yd).abs().max() < 1e-3
    assert (sampled.yd_dot - exact.yd_dot)[0, 3:].abs().max() < 1e-2 * exact.yd_dot.abs().max()
    assert (sampled.yd_dot - exact.yd_dot)[0, -500:].abs().max() < 1e-3


def test_scripted_stream_gives_the_same_bits_as_the_batch() -> None:
    t = 1e-4 * torch.arange(500, dtype=torch.float64)
    yr = reference(t)[0]
    batch = torch.stack(ReferenceFilter(1e-4)(yr[None]), -1)[0]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
        scripted = torch.jit.script(ReferenceFilter(1e-4).stream())
    for _ in range(2):
        scripted.reset()
        streamed = torch.tensor([scripted.step(sample) for sample in yr.tolist()], dtype=torch.float64)
        assert torch.equal(streamed, batch)


def test_the_fast_trajectory_of_the_paper_starts_from_rest() -> None:
    t = 1e-4 * torch.arange(1000, dtype=torch.float64)
    phase = -math.pi / 2
    fast = 4.5 + 1.5 * torch.sin(64 * math.pi * t + phase)
    fast = fast + torch.sin(80 * math.pi * t + phase) + torch.sin(100 * math.pi * t + phase)
    motion = ReferenceFilter(1e-4)(fast[None])
    assert motion.yd[0, 0] == 0 and motion.yd_dot[0, 0] == 0
    assert motion.yd_dot.abs().max().item() == pytest.approx(895.7, abs=2.0)  # checklist, eq. 16


def test_invalid_filter_parameters_are_named_in_the_error() -> None:
    with pytest.raises(ConfigError, match=r"sample_period_s: found 0.0, expected a positive number of s"):
        ReferenceFilter(0.0)
    with pytest.raises(ConfigError, match=r"damping_ratio: found -1.0"):
        ReferenceFilter(1e-4, damping_ratio=-1.0)
