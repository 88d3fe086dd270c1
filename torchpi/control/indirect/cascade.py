"""Static hysteresis in cascade with linear dynamics, and the cascaded inverse.

    y = G(s) H[u],   G(s) = e^(-τs) / (1 + τ_1 s + τ_2 s²)    →   u = H⁻¹[y_d + τ_1 ẏ_d + τ_2 ÿ_d] (t + τ)

Croft, Shed and Devasia, *Creep, hysteresis, and vibration compensation for piezoactuators: atomic force
microscopy application*, ASME J. Dyn. Syst. Meas. Control 123(1), 2001. The rate dependence is put into G, and
the hysteresis stays rate-independent. The desired trajectory has to be smooth; the delay is undone by as many
samples of preview. The forward model is `torchpi.operators.chain.Chain(hysteresis=…, dynamics=…)`.
"""

import math
from collections.abc import Sequence

import torch

from torchpi.control.indirect.base import IndirectInverse
from torchpi.operators.dead_zone import DeadZones
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.sensor_lag import SensorLag


class CascadedInverse(IndirectInverse):
    """The inverse of the dynamics before the exact inverse of the hysteresis.

    Args:
        sample_period_s: T of the control loop.
        thresholds: r of the hysteresis, V, rising from 0.
        weights: w of the hysteresis, µm/V.
        lead: τ_1 in s, and τ_2 in s² if G is of second order; see `lead_of`.
        saturation: Dead zones behind the plays; None is none.
        preview: How many samples ahead the desired trajectory is seen: the delay τ.
        min_voltage_v: Lower output limit.
        max_voltage_v: Upper output limit.

    Raises:
        ConfigError: A hysteresis that has no inverse, or a value out of its range.
    """

    def __init__(
        self,
        sample_period_s: float,
        thresholds: Sequence[float],
        weights: Sequence[float],
        lead: Sequence[float],
        saturation: DeadZones | None = None,
        preview: int = 0,
        min_voltage_v: float = 0.0,
        max_voltage_v: float = 10.0,
    ) -> None:
        super().__init__(
            sample_period_s,
            thresholds,
            weights,
            lead=lead,
            saturation=saturation,
            preview=preview,
            min_voltage_v=min_voltage_v,
            max_voltage_v=max_voltage_v,
        )


def lead_of(dynamics: SensorLag | Resonance) -> list[float]:
    """τ_1 and, for a mode, τ_2: what undoes these dynamics exactly, on a trajectory that is smooth."""
    with torch.no_grad():
        if isinstance(dynamics, SensorLag):
            return [1 / (2 * math.pi * dynamics.cutoff_hz.item())]
        omega = 2 * math.pi * dynamics.frequency_hz.item()
        return [2 * dynamics.damping_ratio.item() / omega, 1 / omega**2]
