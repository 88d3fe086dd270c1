"""A loop that grows with the bias or the rate grows about its chord: the straight part compensates."""

import numpy as np
import pytest
import torch

from tests.diagnosis.plants import multisine
from torchpi.stage.hysteresis import Hysteresis

PERIOD_S = 5e-4
THRESHOLDS_V, WEIGHTS = [0.0, 1.0, 2.5], [0.7, 0.2, 0.1, 0.0]


def displacement(v: np.ndarray, **shape: float) -> np.ndarray:
    stage = Hysteresis(PERIOD_S, THRESHOLDS_V, WEIGHTS, shape=shape)
    with torch.no_grad():
        return stage(torch.from_numpy(v)[None])[0][0].numpy()


def test_with_a_straight_share_incongruence_scales_the_loop_about_its_chord() -> None:
    v = multisine(2000)
    y, kappa, chord = displacement(v), 0.03, 0.85
    # y + κ v (y - g v): the plays with memory sum to y - 0.7 v, so 0.7 b = g - 0.7.
    share = (chord - 0.7) / 0.7
    found = displacement(v, incongruence_per_v=kappa, straight_share=share)
    assert found == pytest.approx(y + kappa * v * (y - chord * v), abs=1e-12)


def test_with_a_chord_share_the_rate_widens_the_loop_about_its_chord() -> None:
    v = multisine(2000)
    y, gamma, reference, gain = displacement(v), 0.02, 30.0, sum(WEIGHTS)
    rate = np.abs(np.diff(v, prepend=0.0)) / PERIOD_S
    found = displacement(v, loop_per_e=gamma, reference_rate_v_s=reference, chord_share=0.8)
    widened = y + gamma * np.log1p(rate / reference) * (y - 0.8 * gain * v)
    assert found == pytest.approx(widened, abs=1e-12)
