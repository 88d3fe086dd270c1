"""Fig. 12: the two trajectories, and the definitions of their errors."""

import numpy as np
import pytest
import torch

from torchpi.paper import fig12, unseen
from torchpi.paper.tracking import StraightLine, follow, loading_samples, tracking_error
from torchpi.recordings.recording import Recording


class Late:
    """A noise-free stage of 0.8 µm/V with a delay of `samples`."""

    sample_rate_hz = 1e4
    sample_period_s = 1e-4
    min_voltage_v = 0.0
    max_voltage_v = 10.0
    seed = 1

    def __init__(self, samples: int) -> None:
        self.samples = samples

    def simulate(self, u: torch.Tensor, seed: int | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        y = 0.8 * torch.cat([torch.zeros(1, self.samples, dtype=u.dtype), u], 1)[:, : u.shape[1]]
        return y, y + 0.01


def straight(preview: int) -> StraightLine:
    u = np.linspace(0, 10, 200)
    return StraightLine(Recording("slow", u, u, 0.8 * u, 1e4), preview)


@pytest.mark.parametrize("name", fig12.TRAJECTORIES)
def test_a_preview_compensates_a_delay(name: str) -> None:
    panel = fig12.panel(Late(3), name, {"ahead": straight(3), "without": straight(0)})
    assert panel.tracked["ahead"].error.max_um_after_loading < 1e-12
    assert panel.tracked["ahead"].on_sensor.max_um_after_loading == pytest.approx(0.01)
    top_rate = {"slow": 94.2, "fast": 895.7}[name]  # including the filter's initial transient
    assert panel.tracked["without"].error.max_um <= 3e-4 * top_rate * 4
    assert panel.tracked["without"].error.max_um_after_loading > 0.5 * 3e-4 * {"slow": 94, "fast": 831}[name]


def test_percentages_refer_to_the_reference_without_the_rise_from_rest() -> None:
    peaks = {name: fig12.panel(Late(1), name, {}).peak_to_peak_um for name in fig12.TRAJECTORIES}
    assert peaks["slow"] == pytest.approx(6.0, abs=1e-6)
    assert peaks["fast"] == pytest.approx(6.826, abs=1e-3)
    yd = np.array([0.0, 4.0, 7.0, 1.0])
    error = tracking_error(yd + np.array([0.0, -0.5, 0.0, 0.3]), yd, 6.0)
    assert error.max_percent == pytest.approx(100 * 0.5 / 6)
    assert error.max_percent_of_travel == pytest.approx(100 * 0.5 / 8.1)
    assert (error.extreme_um, error.max_um_after_loading) == (pytest.approx(-0.5), pytest.approx(0.3))


def test_loading_ends_where_the_trajectory_first_reaches_its_maximum() -> None:
    assert loading_samples(np.array([0.0, 3.0, 5.0, 4.9999, 5.0])) == 2


def test_a_motion_rests_beyond_its_end_unless_a_continuation_is_given() -> None:
    yd = np.linspace(0.0, 4.0, 50)
    rests = follow(straight(5), Late(0), yd)
    np.testing.assert_allclose(rests.y[-6:], 4.0)
    np.testing.assert_allclose(rests.y[:44], yd[5:49])
    goes_on = follow(straight(5), Late(0), yd, np.full(5, 2.0))
    np.testing.assert_allclose(goes_on.y[-5:], 2.0)


def test_unseen_trajectories_differ_and_stay_within_range() -> None:
    trials = [unseen.trial(straight(2), Late(2), seed, 0.4) for seed in (1, 2, 3)]
    assert len({one.top_rate_um_s for one in trials}) == 3
    assert all(one.error.max_um_after_loading < 1e-12 for one in trials)
    median, worst = unseen.median_and_worst(trials, "max_percent")
    assert median <= worst
