"""Plays between the samples."""

import numpy as np
import torch

from torchpi.operators.oversampled_plays import HALF_LENGTH, play_excess
from torchpi.operators.play import PlayBank

R = np.array([0.2, 0.7])


def test_of_a_slow_signal_they_are_the_plays_of_its_samples() -> None:
    t = np.arange(2000) / 2000
    u = np.stack([np.sin(2 * np.pi * 2 * t), 0.5 * np.sin(2 * np.pi * 3 * t)], 1)
    h = PlayBank(R.tolist())(torch.from_numpy(u.T.copy()))[0].detach().numpy().swapaxes(0, 1)
    inner = slice(2 * HALF_LENGTH, -2 * HALF_LENGTH)
    np.testing.assert_allclose(play_excess(u, R)[inner], (h - u[..., None])[inner], atol=5e-3)


def test_they_turn_where_the_signal_turns_between_samples() -> None:
    # Five samples to two periods: the samples alone reach a different height in each.
    u = np.sin(2 * np.pi * 0.4 * np.arange(1000) + 0.3)[:, None]
    r = np.array([0.99])
    assert np.abs(play_excess(u, r) + u[..., None])[300:700].max() < 0.02
    assert np.abs(play_excess(1.2 * u, r) + 1.2 * u[..., None])[300:700].max() > 0.1


def test_without_thresholds_there_is_nothing() -> None:
    assert play_excess(np.ones((10, 2)), np.zeros(0)).shape == (10, 2, 0)
