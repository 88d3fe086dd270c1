"""The one-sided dead-zone operator: the saturation operator that the polynomial of eq. 4 replaces (Fig. 4).

    S_d(x) = max{x - d, 0} for d > 0,   x for d = 0,   min{x - d, 0} for d < 0
    S(x) = Σ_i w_i S_di(x)

Kuhnen, *Modeling, identification and compensation of complex hysteretic nonlinearities: a modified
Prandtl–Ishlinskii approach*, European J. Control 9(4), 2003; Ang, Garmón, Khosla and Riviere, *Modeling
rate-dependent hysteresis in piezoelectric actuators*, IROS 2003, with d ≥ 0 only; Tan et al., 2009.
"""

import torch
from torch import Tensor, nn

from torchpi.errors import ConfigError
from torchpi.operators.base import Static, StaticStream
from torchpi.operators.weighted_sum import weighted_sum


def dead_zone(x: float, d: float) -> float:
    """Return S_d(x), which is 0 until x is beyond the threshold `d`, on the side of zero where d lies."""
    if d > 0.0:
        return max(x - d, 0.0)
    if d < 0.0:
        return min(x - d, 0.0)
    return x


def dead_zones(x: float, d: list[float], w: list[float]) -> float:
    """Return Σ_i w_i S_di(x), summed left to right. Streams and kernels of the inverses compile this."""
    total = 0.0
    for i in range(len(d)):
        total += w[i] * dead_zone(x, d[i])
    return total


class DeadZones(Static):
    """A weighted sum of one-sided dead zones: piecewise linear through the origin, memoryless.

    Args:
        thresholds: d, unit of the input, strictly rising; one of them must be 0. Without negative
            ones it is the operator of Ang et al., with both signs that of Kuhnen.
        weights: w, one per threshold, output per input; w of d = 0 is the slope at the origin.

    Raises:
        ConfigError: Thresholds that do not rise, none that is 0, a number that is not finite, or not
            as many weights as thresholds.
    """

    def __init__(self, thresholds: list[float], weights: list[float]) -> None:
        super().__init__()
        d = torch.as_tensor(thresholds, dtype=torch.float64)
        finite = d.ndim == 1 and bool(torch.isfinite(d).all())
        if not finite or not bool((d.diff() > 0).all()) or not bool((d == 0).any()):
            raise ConfigError(
                f"thresholds: found {list(thresholds)}, expected finite numbers that rise, one of them 0"
            )
        w = torch.as_tensor(weights, dtype=torch.float64)
        if w.shape != d.shape or not bool(torch.isfinite(w).all()):
            raise ConfigError(
                f"weights: found {list(weights)}, expected {len(d)} finite numbers, one a threshold"
            )
        self.d: Tensor
        self.register_buffer("d", d.clone())
        self.w = nn.Parameter(w.clone())

    @property
    def slopes(self) -> Tensor:
        """Slope of each straight piece, from the most negative input to the most positive one."""
        w, negative = self.w.detach(), self.d < 0
        zero = w[self.d == 0]
        below = zero + w[negative].flip(0).cumsum(0).flip(0)
        above = zero + w[self.d > 0].cumsum(0)
        return torch.cat([below, zero, above])

    def pieces(
        self,
        x: Tensor,  # (batch, time)
    ) -> Tensor:  # (batch, time, zones)
        """Return S_di(x), which the weights multiply: the columns of their least-squares problem."""
        shifted = x[..., None] - self.d.to(x.dtype)
        return torch.where(
            self.d > 0,
            torch.relu(shifted),
            torch.where(self.d < 0, -torch.relu(-shifted), x[..., None]),
        )

    def of(self, x: Tensor) -> Tensor:
        return weighted_sum(self.pieces(x), torch.ones_like(x)[..., None], self.w.to(x.dtype)[:, None])

    def inverse(self) -> "DeadZones":
        """Return the inverse of this operator, which is of the same kind (Kuhnen 2003).

            d'_i = S(d_i),   w'_0 = 1 / w_0,   w'_i = 1 / A_i - 1 / A_(i-1)

        with A_i the slope beyond d_i, counted outwards from zero on either side.

        Raises:
            ConfigError: A slope that is not positive, so that there is no inverse.
        """
        slopes = self.slopes
        if not bool((slopes > 0).all()):
            raise ConfigError(
                f"weights: the slopes are {slopes.tolist()}, expected all positive: no inverse otherwise"
            )
        reciprocal = 1.0 / slopes
        at = int((self.d == 0).nonzero())
        w = torch.cat(
            [reciprocal[:at] - reciprocal[1 : at + 1], reciprocal[at : at + 1], reciprocal[at:].diff()]
        )
        d = self(self.d[None])[0][0].detach()
        return DeadZones(d.tolist(), w.tolist())

    def stream(self) -> "DeadZonesStream":
        return DeadZonesStream(self.d.tolist(), self.w.tolist())

    def extra_repr(self) -> str:
        return f"zones={len(self.d)}, thresholds {self.d[0].item():.4g} … {self.d[-1].item():.4g}"


class DeadZonesStream(StaticStream):
    """The operator, one sample at a time."""

    d: list[float]
    w: list[float]

    def __init__(self, d: list[float], w: list[float]) -> None:
        super().__init__()
        self.d = d
        self.w = w

    @torch.jit.export
    def step(self, x: float) -> float:
        return dead_zones(x, self.d, self.w)


def fit_dead_zones(
    x: Tensor,  # (samples,)
    s: Tensor,  # (samples,)
    thresholds: list[float],
) -> DeadZones:
    """Fit the weights to `s` over `x` by least squares, for given thresholds.

    Raises:
        ConfigError: Thresholds that `DeadZones` refuses.
    """
    zones = DeadZones(thresholds, [1.0] * len(thresholds))
    columns = zones.pieces(x[None])[0]
    zones.w = nn.Parameter(torch.linalg.lstsq(columns, s[:, None]).solution[:, 0])
    return zones
