"""Fig. 13 as numbers: width and nonlinearity of known loops."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.paper.fig13 import FREQUENCIES_HZ, HIGH_UM, LOW_UM, loop, width_and_bend


@given(st.floats(0.0, 1.0), st.floats(0.5, 1.5))
def test_an_ellipse_has_its_known_width_and_no_nonlinearity(r: float, gain: float) -> None:
    """A lag of angle φ at amplitude A gives an ellipse of width 2 A sin φ."""
    phase = np.linspace(0, 2 * np.pi, 4001)
    lag = 0.2 * r
    yd, y = 4 - 3 * np.cos(phase), gain * (4 - 3 * np.cos(phase - lag))
    width, bend = width_and_bend(yd, y)
    assert width == pytest.approx(gain * 6 * np.sin(lag), abs=0.02)
    assert bend < 1e-3


def test_a_curved_line_has_nonlinearity_but_no_width() -> None:
    yd = 4 - 3 * np.cos(np.linspace(0, 2 * np.pi, 4001))
    width, bend = width_and_bend(yd, yd + 0.1 * (yd - 4) ** 2)
    assert width < 1e-2
    assert bend == pytest.approx(0.6, rel=0.1)  # a parabola of height 0.9 about its straight line


class Copy:
    """A compensator that passes its input on, and a plant that delays it by the preview."""

    sample_rate_hz = 1e4
    sample_period_s = 1e-4
    preview = 4
    seed = 0
    min_voltage_v, max_voltage_v = 0.0, 10.0

    def reset(self) -> None: ...

    def block(self, yd: torch.Tensor) -> torch.Tensor:
        return yd

    def simulate(self, u: torch.Tensor, seed: int | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        y = torch.cat([torch.zeros(1, 4, dtype=u.dtype), u], 1)[:, : u.shape[1]]
        return y, y


@pytest.mark.parametrize("hz", FREQUENCIES_HZ[2:])
def test_a_perfect_stage_has_no_width_or_nonlinearity_at_any_frequency(hz: int) -> None:
    judged = loop(Copy(), Copy(), hz)
    assert max(judged.width_percent, judged.nonlinearity_percent, judged.max_percent) < 0.05
    assert judged.yd.min() == pytest.approx(LOW_UM, abs=0.02)
    assert judged.yd.max() == pytest.approx(HIGH_UM, abs=0.02)
    cycles = (len(judged.yd) - 1) * hz / 1e4
    assert cycles == pytest.approx(round(cycles))
