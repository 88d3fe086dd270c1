"""Static hysteresis in cascade with linear dynamics, and the cascaded inverse.

    y = G(s) H[u],   G(s) = e^(-τs) / (1 + τ_1 s + τ_2 s²)    →   u = H⁻¹[y_d + τ_1 ẏ_d + τ_2 ÿ_d] (t + τ)

Croft, Shed and Devasia, *Creep, hysteresis, and vibration compensation for piezoactuators: atomic force
microscopy application*, ASME J. Dyn. Syst. Meas. Control 123(1), 2001. The rate dependence is put into G, and
the hysteresis stays rate-independent. The desired trajectory must be smooth; as many samples of preview undo
the delay. The forward model is `torchpi.operators.chain.Chain(hysteresis=…, dynamics=…)`.
"""

import math

import torch

from torchpi.control.indirect.base import IndirectInverse
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.sensor_lag import SensorLag


class CascadedInverse(IndirectInverse):
    """The inverse of the dynamics, `lead` (see `lead_of`) and `preview`, before that of the hysteresis."""


def lead_of(dynamics: SensorLag | Resonance) -> list[float]:
    """Return τ_1 and, for two poles, τ_2, which undo these dynamics exactly on a smooth trajectory.

    Args:
        dynamics: A lag, or a mode, between the hysteresis and the reading.

    Example:
        >>> from torchpi.control.indirect import lead_of
        >>> from torchpi.stage.effects.sensor.sensor_lag import SensorLag
        >>> [f"{tau:.3g} s" for tau in lead_of(SensorLag(1e-4, cutoff_hz=800.0))]
        ['0.000199 s']
    """
    with torch.no_grad():
        if isinstance(dynamics, SensorLag):
            lag_s = 1 / (2 * math.pi * dynamics.cutoff_hz.item())
            first, second = lag_s, (lag_s / (2 * dynamics.damping_ratio.item())) ** 2
            return [first] if dynamics.poles() == 1 else [first, second]
        omega = 2 * math.pi * dynamics.frequency_hz.item()
        return [2 * dynamics.damping_ratio.item() / omega, 1 / omega**2]
