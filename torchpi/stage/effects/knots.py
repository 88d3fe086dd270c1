"""A slow signal that no recorded signal drives: linear between knots, and 0 at the first sample.

The piecewise linear interpolation of a random walk keeps the first terms of its expansion in triangles
(Lévy, 1948; Ciesielski, *Hölder conditions for realizations of Gaussian processes*, Trans. American
Mathematical Society 99, 1961). Behind the last knot the signal is constant.
"""

import math
from typing import Any

import torch
from torch import Tensor

from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import DataRange

KNOTS = 8
SPACING: Any = Quantity("s", at_least=1e-6, at_most=1e6, identity=1.0)
"""Bounds of the time from one knot to the next."""


def knot_names(unit: str) -> tuple[str, ...]:
    """Return knot1 … knot8, with the suffix of the unit if there is one."""
    return tuple(f"knot{k}{unit}" for k in range(1, KNOTS + 1))


def between(left: float, right: float, share: float) -> float:
    """Interpolate linearly from `left` (share 0) to `right` (share 1). Tensors are accepted as well."""
    return left + share * (right - left)


def through_knots(
    elapsed: Tensor,  # (batch, 1), samples elapsed before the first one
    time: int,
    period_s: float,
    spacing_s: Tensor,  # ()
    knots: Tensor,  # (KNOTS,), at spacing, 2 spacing, …
) -> Tensor:  # (batch, time)
    """Return the signal at `time` samples."""
    if not knots.requires_grad and not knots.any():
        return knots.new_zeros(len(elapsed), time)
    place = (elapsed + torch.arange(time, dtype=torch.float64)) * period_s / spacing_s
    before = torch.clamp(torch.floor(place.detach()), 0, len(knots) - 1)
    values = torch.cat([knots.new_zeros(1), knots])
    left, right = values[before.long()], values[before.long() + 1]
    return between(left, right, torch.clamp(place - before, max=1.0))  # type: ignore[arg-type, return-value]


def walk_start(seen: DataRange, size: float, unit: str) -> list[dict[str, float]]:
    """Return the start of a search for a walk of about this size, if every recording's voltage repeats:
    otherwise a signal that may take any shape would absorb every slow effect."""
    if not seen.repeats or size == 0:
        return []
    return [{"knot_spacing_s": seen.duration_s / KNOTS, **dict.fromkeys(knot_names(unit), size)}]


def walk_at(elapsed: float, n: list[float], first: int) -> float:
    """Return the signal `elapsed` samples after the first; n begins with the period and holds, from `first`
    on, the spacing and the knots."""
    place = elapsed * n[0] / n[first]
    before = min(math.floor(place), len(n) - first - 2)
    left = n[first + before] if before > 0 else 0.0
    return between(left, n[first + before + 1], min(place - before, 1.0))
