"""Noise is the same however it is drawn."""

import pytest
import torch

from torchpi.operators.noise import NoiseStream, white_noise


def test_stream_gives_row_0_of_the_batch_sample_by_sample():
    stream = NoiseStream(seed=7)
    wanted = white_noise(7, 2, 3000)[0].tolist()
    assert [stream.step() for _ in range(3000)] == wanted
    stream.reset(7)
    assert [stream.step() for _ in range(5)] == wanted[:5]


def test_a_row_depends_on_neither_the_batch_size_nor_the_length():
    assert torch.equal(white_noise(3, 4, 100)[:2, :60], white_noise(3, 2, 60))


def test_it_is_white_of_unit_variance_and_differs_between_rows_and_seeds():
    first, second = white_noise(0, 2, 20_000)
    other = white_noise(1, 1, 20_000)[0]
    assert first.std().item() == pytest.approx(1.0, abs=0.02)
    for partner in (second, other, first.roll(1)):
        assert abs((first * partner).mean().item()) < 0.03
