"""The lag of a record is estimated at its reversals, whatever its hysteresis is."""

import numpy as np
import pytest
import torch

from torchpi.identification.pair import InversePair
from torchpi.identification.reversals import lag_at_reversals
from torchpi.operators.motion import Motion

FS_HZ = 1000.0


def record(u: np.ndarray, late: int, narrow: float, noise_um: float = 1e-3) -> InversePair:
    """Return a loop of many plays; a smaller `narrow` gives narrow plays a larger share."""
    r = np.linspace(0.0, 4.0, 401)
    weights = np.exp(-r / narrow)
    y, h = np.zeros(len(u)), np.zeros(len(r))
    for k, voltage in enumerate(u):
        h = np.clip(h, voltage - r, voltage + r)
        y[k] = weights @ h / weights.sum()
    y = np.pad(y, (late, 0))[: len(u)] + np.random.default_rng(0).normal(0, noise_um, len(u))
    made = torch.from_numpy(y)[None]
    return InversePair("r", Motion(made, made, made), torch.from_numpy(u)[None], slice(50, None), 1 / FS_HZ)


def sine(hertz: float, seconds: float = 8.0) -> np.ndarray:
    wave: np.ndarray = 5 * (1 - np.cos(2 * np.pi * hertz * np.arange(round(seconds * FS_HZ)) / FS_HZ))
    return wave


@pytest.mark.parametrize("late", [0, 2, 7])
@pytest.mark.parametrize("narrow", [1.0, 10.0])
@pytest.mark.parametrize("u", [sine(0.7), 10 * np.abs(sine(0.7) / 5 - 1)], ids=["sine", "other"])
def test_the_lag_is_found_from_repetitions_of_a_single_loop(u: np.ndarray, late: int, narrow: float) -> None:
    lag = lag_at_reversals(record(u, late, narrow), 64)
    assert lag is not None
    assert lag.mean == pytest.approx(late, abs=0.7) and lag.standard_error < 0.5


@pytest.mark.parametrize(
    "u",
    [np.linspace(0.0, 10.0, 4000), sine(0.2), np.random.default_rng(1).uniform(0, 10, 4000)],
    ids=["a ramp", "one period", "reversals at every sample"],
)
def test_no_lag_is_estimated_from_too_few_usable_reversals(u: np.ndarray) -> None:
    assert lag_at_reversals(record(u, 2, 1.0), 64) is None
