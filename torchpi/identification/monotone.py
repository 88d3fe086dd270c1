"""Check that an inverse cannot run backwards: a compensator must raise the voltage to raise the stage."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchpi.control.direct_inverse import DirectInverse


@dataclass(frozen=True)
class Monotone:
    """Smallest slopes of an inverse over the motions it is meant for; negative ones mean running backwards.

    A run in one direction moves the plays one after another, the smallest threshold first, so the slope
    of the voltage against S(y) passes through the sums Σ_{i≤j} dg_i/dh_i over the plays sorted by
    threshold; without own output functions these are the sums of the weights w_i(ẏ).

    Attributes:
        least_weight_sum: The smallest of these sums over all j and all rates, V/µm.
        at_rate_um_s: The rate at which it occurs, µm/s.
        least_saturation_slope: The smallest S'(y) over the range.
        at_um: The displacement at which it occurs, µm.
    """

    least_weight_sum: float
    at_rate_um_s: float
    least_saturation_slope: float
    at_um: float

    def __bool__(self) -> bool:
        return self.least_weight_sum > 0 and self.least_saturation_slope > 0

    def __str__(self) -> str:
        if self:
            least = self.least_weight_sum * self.least_saturation_slope
            return (
                "the voltage never runs backwards: over the range and the rates of the training it moves one "
                f"way with the displacement, by {least:.3g} V/µm at least"
            )
        where = (
            f"the weights of the moving plays sum to {self.least_weight_sum:.3g} V/µm "
            f"at {self.at_rate_um_s:.4g} µm/s"
            if self.least_weight_sum <= 0
            else f"S' is {self.least_saturation_slope:.3g} at {self.at_um:.3g} µm"
        )
        return (
            f"the inverse runs backwards within the recorded range: {where}; "
            "take fewer plays, a lower degree, or rate: none, or record what is missing there"
        )


def monotone(
    compensator: DirectInverse,
    range_um: tuple[float, float],
    rates_um_s: tuple[float, float],
) -> Monotone:
    """Check the inverse over a range of displacement and of (signed) rate."""
    with torch.no_grad():
        rate = torch.linspace(*rates_um_s, 201, dtype=torch.float64)[None]
        order = compensator.plays.r.argsort()
        own = _own_slopes(compensator, range_um)  # (positions, plays)
        slopes = compensator.weights(rate)[0][:, None, :] + own  # (rates, positions, plays)
        sums = slopes[..., order].cumsum(-1)
        # A sensor may be mounted the other way round: the voltage then falls throughout.
        sums = (sums * sums.mean().sign()).amin((1, 2))  # (rates,)
        least = int(sums.argmin())
    y = torch.linspace(*range_um, 201, dtype=torch.float64)[None].requires_grad_()
    (slope,) = torch.autograd.grad(compensator.saturation(y)[0].sum(), y)
    flattest = int(slope[0].argmin())
    return Monotone(
        float(sums[least]),
        float(rate[0, least]),
        float(slope[0, flattest]),
        float(y[0, flattest].detach()),
    )


def _own_slopes(compensator: DirectInverse, range_um: tuple[float, float]) -> Tensor:
    """Return d(Σ_q ψ_iq z^q h)/dh over the range that the plays can reach. Shape: (positions, plays)."""
    ends, _ = compensator.saturation(torch.tensor([range_um], dtype=torch.float64))
    z = torch.linspace(float(ends.min()), float(ends.max()), 21, dtype=torch.float64) / compensator.range_um
    slopes = torch.zeros(len(z), len(compensator.plays.r), dtype=torch.float64)
    for q in range(1, compensator.psi.shape[1] + 1):
        slopes += (q + 1) * z[:, None] ** q * compensator.psi[:, q - 1]
    return slopes
