"""Fig. 3, Qin et al. (2013): plays with negative weights give the loop of an inverse."""

import torch

from torchpi.control.indirect.conventional import conventional_inverse
from torchpi.operators.prandtl_ishlinskii import PrandtlIshlinskii

THRESHOLDS = [0.0, 0.1, 0.3, 0.6, 1.0]
WEIGHTS = [10.0, -5.0, -5 / 3, -5 / 6, -0.5]


def inverse() -> PrandtlIshlinskii:
    """Return the operator of Fig. 3."""
    return PrandtlIshlinskii(THRESHOLDS, WEIGHTS)


def forward() -> PrandtlIshlinskii:
    """Return the operator whose conventional inverse Fig. 3 shows: r = [0 1 2 3 4], every weight 0.1."""
    return PrandtlIshlinskii([0.0, 1.0, 2.0, 3.0, 4.0], [0.1] * 5)


def round_trip(samples: int = 20_000) -> float:
    """Return the largest error of Fig. 3 and its forward operator in series, in both orders, on ±5.

    The input has minor loops. Inverting Fig. 3 in closed form must also give the forward operator.
    """
    t = torch.linspace(0, 1, samples, dtype=torch.float64)[None]
    x = 3.5 * torch.sin(6 * torch.pi * t) + 1.5 * torch.sin(46 * torch.pi * t)
    with torch.no_grad():
        errors = [
            second(first(x)[0])[0] - x
            for first, second in (
                (forward(), inverse()),
                (inverse(), forward()),
                (forward(), conventional_inverse(forward())),
                (inverse(), conventional_inverse(inverse())),
            )
        ]
    return max(float(error.abs().max()) for error in errors)
