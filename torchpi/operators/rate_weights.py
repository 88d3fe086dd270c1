"""Weights of the plays as functions of the input rate, Qin et al. (2013), eq. 7, and beyond."""

import math
from typing import Literal

import torch
from torch import Tensor, nn

from torchpi.errors import ConfigError

RateHead = Literal["none", "linear", "neural"]
LARGEST_HEAD = 1000


def squash(z: float) -> float:
    """Return z / (1 + |z|), a smooth step made only of operations that IEEE 754 rounds exactly, so that
    batch, stream and C agree to the last bit. A tanh or sqrt differs between libraries. Also for tensors."""
    return z / (1.0 + abs(z))


class RateWeights(nn.Module):
    """w(ẏ) = k ẏ + b, signed rate; as `neural`, + Σ_j W_j squash(a_j ẏ/ẏ_scale + c_j).

    The first form is eq. 7.

    All kinds are linear in θ = (b, k, W) over a basis φ(ẏ) = (1, ẏ/ẏ_scale, squash_1, …), so least
    squares can find θ for a fixed basis. At W = 0 the neural head reduces to the linear one, and at
    k = 0 that reduces to eq. 3.

    Args:
        weights: b, one per play, output per unit of the play's input; may be negative.
        kind: `none` (b alone), `linear` or `neural`.
        rate_scale_um_s: A typical size of the rate, ẏ_scale.
        hidden: Number of squashed functions of the rate in the neural head.

    Raises:
        ConfigError: An unknown kind, a scale that is not positive, or `hidden` below 1.

    Example:
        >>> import torch
        >>> from torchpi.operators import RateWeights
        >>> weights = RateWeights([0.7, 0.3], kind="none")
        >>> weights(torch.tensor([[0.0, 500.0]], dtype=torch.float64)).tolist()  # at rest, and at 500 µm/s
        [[[0.7, 0.3], [0.7, 0.3]]]
    """

    def __init__(
        self,
        weights: list[float],
        kind: RateHead = "linear",
        rate_scale_um_s: float = 1.0,
        hidden: int = 4,
    ) -> None:
        super().__init__()
        if kind not in ("none", "linear", "neural"):
            raise ConfigError(f"rate: found '{kind}', expected none, linear or neural")
        if not 0 < rate_scale_um_s < math.inf:
            raise ConfigError(f"rate_scale_um_s: found {rate_scale_um_s}, expected a positive number of µm/s")
        if not 1 <= hidden <= LARGEST_HEAD:
            raise ConfigError(f"hidden: found {hidden}, expected 1 to {LARGEST_HEAD}")
        self.kind = kind
        self.rate_scale_um_s = rate_scale_um_s
        functions = {"none": 1, "linear": 2, "neural": 2 + hidden}[kind]
        theta = torch.zeros(len(weights), functions, dtype=torch.float64)
        theta[:, 0] = torch.as_tensor(weights, dtype=torch.float64)
        self.theta = nn.Parameter(theta)
        # The steps are spread over the rates in use: both signs, fast and slow.
        knots = hidden if kind == "neural" else 0
        self.slope = nn.Parameter(torch.full((knots,), 3.0, dtype=torch.float64))
        self.shift = nn.Parameter(torch.linspace(-2.0, 2.0, knots, dtype=torch.float64))

    def basis(self, yd_dot: Tensor) -> Tensor:
        """Return φ(ẏ). Shape: (batch, time) µm/s to (batch, time, functions)."""
        z = yd_dot / self.rate_scale_um_s
        functions = [torch.ones_like(z)]
        if self.kind != "none":
            functions.append(z)
        for a, c in zip(self.slope.to(z.dtype), self.shift.to(z.dtype), strict=True):
            functions.append(squash(a * z + c))  # type: ignore[arg-type]
        return torch.stack(functions, -1)

    def forward(self, yd_dot: Tensor) -> Tensor:
        """Return the weights at each rate. Shape: (batch, time) µm/s to (batch, time, plays)."""
        return self.basis(yd_dot) @ self.theta.T

    @property
    def b(self) -> Tensor:
        """Offsets of eq. 7, (plays,)."""
        return self.theta[:, 0]

    @property
    def k(self) -> Tensor:
        """Slopes of eq. 7 per µm/s, (plays,); zero where the head has none."""
        if self.kind == "none":
            return torch.zeros_like(self.b)
        return self.theta[:, 1] / self.rate_scale_um_s

    def extra_repr(self) -> str:
        return f"kind={self.kind}, plays={len(self.theta)}"
