"""Every fitted method recovers the plant behind its recordings, and reports when it cannot."""

import numpy as np
import pytest
import torch

from torchpi.control.indirect import TimeVaryingThresholdPI
from torchpi.errors import ConfigError
from torchpi.excitation.signals import paper_multisine, sine_5hz
from torchpi.identification import inverse_pair
from torchpi.identification.indirect import (
    Records,
    fit_cascade,
    fit_conventional,
    fit_generalised_direct,
    fit_rate_dependent,
    fit_time_varying_thresholds,
)
from torchpi.operators import PrandtlIshlinskii
from torchpi.operators.base import Operator
from torchpi.operators.chain import Chain
from torchpi.operators.dead_zone import DeadZones
from torchpi.operators.rate_dependent_pi import RateDependentPI
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.sensor.sensor_lag import SensorLag

PERIOD_S = 1e-4
R, W = [0.0, 0.5, 1.5, 3.0], [0.7, 0.05, 0.1, 0.08]


def records(plant: Operator, thresholds: list[float] = R, **options) -> Records:
    """The paper's two recordings of a plant, without noise."""
    pairs = []
    for name, (t, u) in {"slow": sine_5hz(0.4), "fast": paper_multisine(0.4)}.items():
        with torch.no_grad():
            y = plant(torch.from_numpy(u)[None])[0][0].numpy()
        pairs.append(inverse_pair(Recording(name, t, u, y, 1 / PERIOD_S), bandwidth_hz=800.0))
    return Records(pairs[0], [pairs[1]], thresholds, **options)


def test_the_conventional_fit_recovers_weights_and_saturation() -> None:
    zones = DeadZones([0.0, 2.0, 4.0], [1.0, 0.1, -0.15])
    plant = Chain(plays=PrandtlIshlinskii(R, W), saturation=zones)
    undone = zones.inverse()
    fitted = records(plant, dead_zones=undone.d.tolist())
    assert fitted.w == pytest.approx(W, abs=2e-3)
    assert fitted.saturation.slopes.tolist() == pytest.approx(zones.slopes.tolist(), abs=5e-3)
    inverse = fit_conventional(fitted)
    y = fitted.fast[0].motion
    assert (inverse(y) - fitted.fast[0].u)[0, 200:-200].abs().max() < 0.03


def test_the_rate_dependent_fit_is_much_better_than_the_conventional_one() -> None:
    k = [-2e-6, 3e-6, 1e-6, 1e-6]
    fitted = records(RateDependentPI(PERIOD_S, R, k, W))
    inverse = fit_rate_dependent(fitted)
    error = inverse(fitted.fast[0].motion) - fitted.fast[0].u
    without = fit_conventional(fitted)(fitted.fast[0].motion) - fitted.fast[0].u
    assert error.square().mean() < 0.2 * without.square().mean()


def test_the_fit_of_time_varying_thresholds_recovers_their_growth() -> None:
    plant = TimeVaryingThresholdPI(PERIOD_S, R, W, [0.0, 4e-4, 4e-4, 4e-4])
    inverse = fit_time_varying_thresholds(records(plant))
    # The plant's growth is per V/s, the compensator's per µm/s.
    rise = np.ptp(plant(torch.linspace(0, 10, 4000, dtype=torch.float64)[None])[0].detach().numpy()) / 10
    assert inverse.rho[0] == 0 and len(set(inverse.rho[1:])) == 1
    assert inverse.rho[1] == pytest.approx(4e-4 / rise, rel=0.25)


def test_the_cascade_fit_finds_the_lead_that_compensates_a_lag() -> None:
    plant = Chain(hysteresis=PrandtlIshlinskii(R, W), dynamics=SensorLag(PERIOD_S, cutoff_hz=500.0))
    assert fit_cascade(records(plant), order=1).lead[0] == pytest.approx(1 / (2 * np.pi * 500), rel=0.1)


def test_a_generalised_fit_of_degree_3_fits_the_slow_record_better_than_degree_1() -> None:
    zones = DeadZones([0.0, 2.0, 4.0], [1.0, 0.1, -0.15])
    fitted = records(Chain(plays=PrandtlIshlinskii(R, W), saturation=zones))
    fitted.fast = [fitted.slow]
    errors = []
    for degree in (1, 3):
        inverse = fit_generalised_direct(fitted, [0.0, 0.2, 0.5, 1.0, 2.0], degree)
        errors.append((inverse(fitted.slow.motion) - fitted.slow.u).square().mean().sqrt().item())
    assert errors[1] < 0.8 * errors[0]
    assert errors[1] < 0.08


def test_a_saturation_without_an_inverse_is_refused_naming_the_record() -> None:
    """A plant whose output decreases near the top yields a slope there that is not positive."""

    class Folding(Operator):
        def forward(self, x, state=None):
            y = torch.where(x < 8, x, 16 - x)
            return y, self.initial_state(len(x))

    with pytest.raises(ConfigError, match=r"slow: .*use fewer dead zones") as refusal:
        records(Folding(), dead_zones=[0.0, *np.linspace(0.5, 7.9, 12)])
    assert "\n" not in str(refusal.value)
