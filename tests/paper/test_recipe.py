"""One direct compensator for the plant of Fig. 7, trained on recordings: its required accuracy."""

import math

import pytest
import torch

from torchpi.operators.motion import backward_motion
from torchpi.paper.fig7_plant import Fig7Plant
from torchpi.paper.recipe import fig7_compensator


@pytest.fixture(scope="module")
def compensator():
    return fig7_compensator(passes=2)


@pytest.mark.parametrize(("hz", "percent"), [(5, 0.3), (10, 0.3), (50, 0.5), (100, 1.0)])
def test_compensated_fig_7_plant_follows_eq_9_in_steady_state(compensator, hz: int, percent: float) -> None:
    period, cycle = compensator.sample_period_s, round(1 / (hz * compensator.sample_period_s))
    t = period * torch.arange(4 * cycle + compensator.preview, dtype=torch.float64)
    yd = 5.5 + 4.5 * torch.sin(2 * math.pi * hz * t - math.pi / 2)
    with torch.no_grad():
        u = compensator(backward_motion(yd[compensator.preview :][None], period))
        y, _ = Fig7Plant().simulate(u)
    error = (y[0] - yd[: 4 * cycle])[-cycle:].abs().max() / 9
    assert 100 * error < percent


def test_the_model_recovers_the_thresholds_of_the_plant(compensator) -> None:
    # Only the test knows these thresholds: the model started from a grid with a spacing of 0.43 V.
    found = compensator.model.plays.r.detach()
    for threshold in Fig7Plant().operator.plays.r:
        assert float((found - threshold).abs().min()) < 5e-3
