"""The default stage is a rig like that of the paper, and the statements in its file are correct."""

from pathlib import Path

import numpy as np
import pytest
import torch

from torchpi.excitation.signals import sine_5hz
from torchpi.stage import Stage

FOLDER = Path(__file__).parents[2] / "configs/stage"


@pytest.fixture
def stage() -> Stage:
    return Stage.from_yaml(FOLDER / "default.yaml").requires_grad_(False)


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.yaml")), ids=lambda path: path.name)
def test_every_stage_file_is_loaded_and_rebuilt_from_its_settings(path):
    stage = Stage.from_yaml(path)
    assert Stage.from_dict(stage.to_dict()).to_dict() == stage.to_dict()


def test_its_range_and_its_loop_width_are_those_of_such_a_rig(stage):
    _, u = sine_5hz(0.6, stage.sample_rate_hz)
    y = stage(torch.tensor(u)[None])[0][0].numpy()
    period = 2000
    # The last loop, each command paired with the displacement that it causes 1.85 samples later.
    u, y = u[2 * period - 2 : 3 * period - 2], y[2 * period :]
    assert y.max() == pytest.approx(8.1, abs=0.02)
    assert y.min() == pytest.approx(0.8, abs=0.02)
    at = np.linspace(0.1, 9.9, 200)
    up = np.interp(at, u[: period // 2], y[: period // 2])
    down = np.interp(at, u[period // 2 :][::-1], y[period // 2 :][::-1])
    width = (down - up) / np.ptp(y)
    assert 0.12 < width.max() < 0.15
    assert abs(width[30:70].mean() - width[130:170].mean()) > 0.003  # not symmetric


def test_its_apparent_delay_is_between_one_and_two_samples(stage):
    ceramic = ("input_nonlinearity", "creep")
    settings = stage.to_dict()
    settings["effects"] = [one for one in settings["effects"] if one["name"] not in ceramic]
    linear = Stage.from_dict({**settings, "hysteresis": {"thresholds_v": [0.0], "weights": [1.0, 0.0]}})
    t = torch.arange(5000, dtype=torch.float64) / 1e4
    for frequency_hz in (5.0, 40.0, 80.0):
        u = torch.sin(2 * torch.pi * frequency_hz * t) + 5
        line = torch.exp(-2j * torch.pi * frequency_hz * t[1000:])
        ratio = (linear(u[None])[0][0, 1000:] * line).sum() / (u[1000:] * line).sum()
        delay = -torch.angle(ratio).item() / (2 * torch.pi * frequency_hz) * 1e4
        assert delay == pytest.approx(1.85, abs=0.02)


def test_its_creep_is_one_and_a_half_per_cent_per_decade(stage):
    u = torch.full((1, 100_001), 5.0, dtype=torch.float64)
    y = stage(u)[0][0]
    at = {seconds: y[round(seconds * 1e4)].item() for seconds in (0.1, 1.0, 10.0)}
    assert (at[1.0] - at[0.1]) / at[0.1] == pytest.approx(0.015, rel=0.05)
    assert (at[10.0] - at[1.0]) / at[0.1] == pytest.approx(0.015, rel=0.05)


def test_its_readings_have_a_noise_of_three_nanometres(stage):
    y, reading = stage.simulate(torch.zeros(1, 20_000, dtype=torch.float64))
    assert float((reading - y).std()) == pytest.approx(0.003, rel=0.05)
