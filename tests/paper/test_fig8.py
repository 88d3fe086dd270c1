"""Fig. 8 with a compensator as it is deployed."""

import numpy as np
import pytest
import torch

from torchpi.paper import fig8


class Straight:
    """u = y_d / gain, with a given preview."""

    sample_period_s = 1e-4

    def __init__(self, preview: int) -> None:
        self.preview = preview
        self.seen: list[torch.Tensor] = []

    def reset(self) -> None:
        self.seen.clear()

    def block(self, yd: torch.Tensor) -> torch.Tensor:
        self.seen.append(yd)
        return yd / 1.2


def test_a_compensator_with_preview_sees_the_sine_continue_beyond_the_record() -> None:
    """The sine continues beyond the record, so that the record does not end at rest."""
    straight = Straight(preview=30)
    panel = fig8.deployed(straight, 50, cycles=2)
    (seen,) = straight.seen
    t = (np.arange(401) + 30) * 1e-4
    np.testing.assert_allclose(seen.numpy(), 5.5 - 4.5 * np.cos(2 * np.pi * 50 * t), atol=1e-12)
    np.testing.assert_allclose(panel.yd, 5.5 - 4.5 * np.cos(2 * np.pi * 50 * t[170:371]), atol=1e-12)


def test_errors_are_percentages_of_9_um_over_the_last_cycle() -> None:
    panel = fig8.deployed(Straight(preview=0), 100)
    assert len(panel.y) == 101
    error = 100 * np.abs(panel.y - panel.yd) / 9
    assert panel.max_percent == pytest.approx(error.max())
    assert panel.rms_percent < panel.max_percent
    assert panel.max_percent > 10  # the uncompensated hysteresis of the plant


def test_the_deployed_indirect_inverse_is_as_good_as_with_its_exact_rate() -> None:
    stream = fig8.fig8_inverse().stream()
    assert fig8.deployed(stream, 50).max_percent == pytest.approx(fig8.indirect(50).max_percent, rel=0.1)
