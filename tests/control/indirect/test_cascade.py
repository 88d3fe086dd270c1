"""Static hysteresis in cascade with linear dynamics, and the cascaded inverse."""

import pytest
import torch

from tests.control.indirect.laws import DeployedLaws
from torchpi.control.indirect import CascadedInverse, ConventionalInverse, lead_of
from torchpi.errors import ConfigError
from torchpi.operators import Chain, PrandtlIshlinskii
from torchpi.operators.motion import Motion
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.sensor_lag import SensorLag

R, W = [0.0, 0.4, 1.0, 2.5], [0.8, 0.1, 0.15, 0.05]


class TestDeployed(DeployedLaws):
    def compensator(self) -> CascadedInverse:
        return CascadedInverse(1e-4, R, W, lead=[2e-4, 6e-8], preview=3)


def sine(period_s: float) -> Motion:
    """Return two periods of eq. 9 at 20 Hz."""
    omega = 2 * torch.pi * 20
    t = period_s * torch.arange(round(0.1 / period_s), dtype=torch.float64)[None]
    return Motion(
        5.5 - 4.5 * torch.cos(omega * t),
        4.5 * omega * torch.sin(omega * t),
        4.5 * omega**2 * torch.cos(omega * t),
    )


@pytest.mark.parametrize("kind", ["lag", "two poles", "mode"])
def test_it_inverts_its_own_cascade_to_second_order_in_the_sample_period(kind: str) -> None:
    """The dynamics interpolate linearly between samples, which leaves an error proportional to T²."""
    errors = []
    for period_s in (2e-4, 1e-4, 5e-5):
        dynamics: SensorLag | Resonance = {
            "lag": SensorLag(period_s, cutoff_hz=300.0),
            "two poles": SensorLag(period_s, cutoff_hz=300.0, damping_ratio=0.7),
            "mode": Resonance(period_s, frequency_hz=600.0, damping_ratio=0.1),
        }[kind]
        forward = Chain(hysteresis=PrandtlIshlinskii(R, W), dynamics=dynamics)
        motion = sine(period_s)
        inverse = CascadedInverse(
            period_s, R, W, lead=lead_of(dynamics), min_voltage_v=-99.0, max_voltage_v=99.0
        )
        error = (forward(inverse(motion))[0] - motion.yd)[0, motion.yd.shape[1] // 2 :]
        errors.append(error.abs().max().item())
    assert errors[0] < 5e-3
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.15)


def test_preview_compensates_a_delay() -> None:
    forward = Chain(hysteresis=PrandtlIshlinskii(R, W), delay=Delay(1e-4, delay_s=5e-4))
    motion = sine(1e-4)
    inverse = CascadedInverse(1e-4, R, W, preview=5)
    assert inverse.stream().preview == 5
    y = forward(inverse(Motion(*(part[:, 5:] for part in motion))))[0]
    assert torch.allclose(y[:, 5:], motion.yd[:, 5:-5], rtol=0, atol=1e-12)


def test_without_dynamics_it_is_the_conventional_inverse(motion: Motion) -> None:
    assert torch.equal(CascadedInverse(1e-4, R, W)(motion), ConventionalInverse(1e-4, R, W)(motion))


@pytest.mark.parametrize(("lead", "named"), [([1.0, 1.0, 1.0], "at most two"), ([float("inf")], "lead")])
def test_an_invalid_lead_is_refused(lead: list[float], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        CascadedInverse(1e-4, R, W, lead=lead)
