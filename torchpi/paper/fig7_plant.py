"""The plant of Fig. 7 and 8, Qin et al. (2013), Section II-C: a rate-dependent Prandtl–Ishlinskii operator.

    y(t) = Σ_i (k_i u̇ + b_i) H_ri[u](t),   r_i = 0.5 (i - 1),  i = 1 … 10

Assumptions: the rate is signed (only that gives the loops of Fig. 7), and "an amplitude of ten" means
0 … 10. The plant responds at once: y(t) depends on u(t), without converter, delay, noise or limits.
"""

from math import isfinite

import numpy as np
import torch
from torch import Tensor

from torchpi.errors import StageError
from torchpi.operators.base import StepStream
from torchpi.operators.rate_dependent_pi import RateDependentPI

SAMPLE_PERIOD_S = 1e-4  # of the paper's rig
THRESHOLDS = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5]  # r, V
SLOPES = [-2e-4, 3e-4, -1e-4, 0.2e-4, -0.4e-4, 0.8e-4, -1e-4, 1e-4, -0.7e-4, -0.6e-4]  # k, µm/V per V/s
OFFSETS = [0.77, 0.097, 0.0066, 0.06, 0.1, 0.062, 0.042, 0.082, 0.022, 0.099]  # b, µm/V
FREQUENCIES_HZ = (1, 5, 10, 50, 100)


class Fig7Plant:
    """The plant as a stage: `simulate` for records, `stream` for a control loop, with identical results.

    The rate is the three-point backward difference of the voltages, for a plant at rest before the first.

    Args:
        sample_period_s: Sample period T.

    Raises:
        ConfigError: The period is not positive.
    """

    # The plant itself has no limits and accepts any voltage. The loop takes its range from here, and an
    # inverse needs less than 0 V to come down to 1 µm (eq. 9).
    min_voltage_v, max_voltage_v = -2.0, 12.0
    seed = 0  # required by the interface of a stage; there is no noise

    def __init__(self, sample_period_s: float = SAMPLE_PERIOD_S) -> None:
        self.operator = RateDependentPI(sample_period_s, THRESHOLDS, SLOPES, OFFSETS)
        self.operator.requires_grad_(False)
        self.sample_period_s = sample_period_s
        self.sample_rate_hz = 1.0 / sample_period_s

    def simulate(
        self,
        u: Tensor,  # (batch, time), V
        seed: int | None = None,  # without effect
    ) -> tuple[Tensor, Tensor]:  # (batch, time), µm, twice
        """Return the displacement and the identical sensor reading; differentiable in `u`.

        Raises:
            StageError: The shape is not (batch, time), or a command is not finite.
        """
        if u.ndim != 2 or not bool(torch.isfinite(u).all()):
            raise StageError(f"u: found shape {tuple(u.shape)}, expected (batch, time), all numbers finite")
        y, _ = self.operator(u.to(torch.float64))
        return y, y

    def at_rate(
        self,
        u: Tensor,  # (batch, time), V
        u_dot: Tensor,  # (batch, time), V/s
    ) -> Tensor:  # (batch, time), µm
        """Return the displacement for an exactly known u̇, as for a sine."""
        y, _ = self.operator.at_rate(u, u_dot)
        return y

    def stream(self) -> "Fig7Stream":
        """Return the plant sample by sample: `reset(seed)`, `step(u)` → (y, reading)."""
        return Fig7Stream(self.operator.stream())


class Fig7Stream:
    """The plant, one sample at a time."""

    def __init__(self, operator: StepStream) -> None:
        self.operator = operator

    def reset(self, seed: int = 0) -> None:
        """Return to the de-energised state."""
        self.operator.reset()

    def step(self, u: float) -> tuple[float, float]:
        """Apply `u`, V, and return displacement and reading, µm.

        Raises:
            StageError: The command is not finite. The state stays as it was.
        """
        if not isfinite(u):
            raise StageError(f"u: found {u} V, expected a finite number")
        y = self.operator.step(u)
        return y, y


def loop(
    frequency_hz: float,
    samples: int = 20_000,  # of one period
) -> tuple[np.ndarray, np.ndarray]:  # u (samples + 1,), V; y, µm
    """Return the closed loop of Fig. 7: the second period of a sine over 0 … 10 V, with its exact rate."""
    phase = 2 * torch.pi * torch.arange(2 * samples + 1, dtype=torch.float64)[None] / samples
    u = 5 - 5 * torch.cos(phase)
    y = Fig7Plant().at_rate(u, 10 * torch.pi * frequency_hz * torch.sin(phase))
    return u[0, samples:].numpy(), y[0, samples:].numpy()


def loop_area(frequency_hz: float) -> float:
    """Return the area enclosed by the loop of Fig. 7, V µm."""
    u, y = loop(frequency_hz)
    return float(abs(np.trapezoid(y, u)))
