"""The conventional inversion with rate-dependent terms put in: the paper's indirect approach.

    y = Σ_i (k_i u̇ + b_i) H_ri[u]   is taken to be undone by   u = Σ_i w'_i(ẏ_d) H_r'i(ẏ_d)[y_d]

with r' and w' by the closed form at every sample, from weights k ẏ_d + b. So thresholds of the inverse move
with the rate as well. Ang, Khosla and Riviere, *Feedforward controller with inverse rate-dependent model for
piezoelectric actuators in trajectory-tracking applications*, IEEE/ASME Trans. Mechatronics 12(2), 2007; Tan,
Latt, Shee, Riviere and Ang, 2009; Qin et al. (2013), Section II-C and Fig. 8.

Not an inverse: the rate is that of the output where the model has that of the input, and plays whose
thresholds move change the output even where the weights would not. The error vanishes with the rate.
"""

from collections.abc import Sequence

from torchpi.control.indirect.base import IndirectInverse
from torchpi.operators.dead_zone import DeadZones


class RateDependentInverse(IndirectInverse):
    """Krejčí–Kuhnen inversion of the weights k ẏ_d + b, at every sample.

    `rates_um_s` is where the model can be inverted: outside of it some w_0 + … + w_i comes down to a
    twentieth of its value at rest, and the rate is held at that end.

    Args:
        sample_period_s: T of the control loop.
        thresholds: r of the forward model, V, rising from 0.
        slopes: k, change of the weights with the signed rate, µm/V per µm/s.
        offsets: b, weights at rest, µm/V.
        saturation: Dead zones behind the plays of the forward model; None is none.
        preview: How many samples ahead the desired trajectory is seen.
        min_voltage_v: Lower output limit.
        max_voltage_v: Upper output limit.

    Raises:
        ConfigError: A forward model that has no inverse at rest, or a value out of its range.
    """

    def __init__(
        self,
        sample_period_s: float,
        thresholds: Sequence[float],
        slopes: Sequence[float],
        offsets: Sequence[float],
        saturation: DeadZones | None = None,
        preview: int = 0,
        min_voltage_v: float = 0.0,
        max_voltage_v: float = 10.0,
    ) -> None:
        super().__init__(
            sample_period_s,
            thresholds,
            offsets,
            weight_slopes=slopes,
            saturation=saturation,
            preview=preview,
            min_voltage_v=min_voltage_v,
            max_voltage_v=max_voltage_v,
        )
