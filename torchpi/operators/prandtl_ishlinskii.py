"""The Prandtl–Ishlinskii operator, Qin et al. (2013), eq. 3: a weighted sum of plays."""

import torch
from torch import Tensor, nn

from torchpi.errors import ConfigError, is_number
from torchpi.operators.base import Operator, StepStream
from torchpi.operators.play import PlayBank, play
from torchpi.operators.weighted_sum import weighted_sum


def sum_step(x: float, n: list[float], s: list[float]) -> float:
    """One step in the form a stream calls: n holds r and w, s the plays."""
    total = 0.0
    for i in range(len(s)):
        s[i] = play(x, n[i], s[i])
        total += n[len(s) + i] * s[i]
    return total


class PrandtlIshlinskii(Operator):
    """y(t) = Σ_i w_i H_ri[x](t). With negative weights it is as well the inverse of such an operator.

    Args:
        thresholds: r, unit of the input.
        weights: w, one per threshold, output per input; may be negative.
        trainable_thresholds: Whether gradients reach the thresholds.

    Raises:
        ConfigError: Invalid thresholds, or not as many weights as thresholds.

    Example:
        >>> import torch
        >>> from torchpi import PrandtlIshlinskii
        >>> voltage = torch.tensor([[0.0, 5.0, 10.0, 5.0, 0.0]], dtype=torch.float64)
        >>> y, _ = PrandtlIshlinskii(thresholds=[0.0, 1.0], weights=[0.6, 0.2])(voltage)
        >>> y[0].tolist()  # the way back lies above the way there
        [0.0, 3.8, 7.8, 4.2, 0.2]
    """

    def __init__(
        self, thresholds: list[float], weights: list[float], trainable_thresholds: bool = False
    ) -> None:
        super().__init__()
        self.plays = PlayBank(thresholds, trainable_thresholds)
        if not all(is_number(weight) for weight in weights):
            raise ConfigError(f"weights: found {weights!r}, expected numbers")
        if len(weights) != len(thresholds):
            raise ConfigError(f"weights: found {len(weights)}, expected {len(thresholds)}, one a play")
        self.w = nn.Parameter(torch.as_tensor(weights, dtype=torch.float64).clone())

    def initial_state(self, batch: int) -> Tensor:
        return self.plays.initial_state(batch)

    def forward(self, x: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        h, state = self.plays(x, state)
        return weighted_sum(h, torch.ones_like(x)[..., None], self.w.to(x.dtype)[:, None]), state

    def stream(self) -> nn.Module:
        return StepStream(sum_step, [*self.plays.r.tolist(), *self.w.tolist()], len(self.w))
