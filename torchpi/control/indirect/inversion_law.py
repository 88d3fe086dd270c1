"""The closed form that inverts a Prandtl–Ishlinskii operator.

For y = Σ_i w_i H_ri[u] with 0 = r_0 ≤ r_1 ≤ …, and A_i = w_0 + … + w_i > 0, the inverse is the operator
u = Σ_i w'_i H_r'i[y] with

    r'_i = Σ_{j≤i} w_j (r_i - r_j),   w'_0 = 1 / w_0,   w'_i = -w_i / (A_i A_(i-1))

Krejčí and Kuhnen, *Inverse control of systems with hysteresis and creep*, IEE Proc. Control Theory Appl.
148(3), 2001. For thresholds that vary in time it still holds where their distances do not shrink (Al Janaideh
and Krejčí, Physica B 406(8), 2011; see `time_varying_thresholds`). Ang and Tan also use it for weights that
vary in time, where it is no longer an inverse: Qin et al. (2013), Section II-C.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

from torchpi.errors import ConfigError


def invert(r: list[float], w: list[float], r_inverse: list[float], w_inverse: list[float]) -> None:
    """Write r' and w' into the last two lists. The kernel and the streams compile this source."""
    slope = w[0]  # A_i
    r_inverse[0] = 0.0
    w_inverse[0] = 1.0 / slope
    for i in range(1, len(r)):
        r_inverse[i] = r_inverse[i - 1] + slope * (r[i] - r[i - 1])
        w_inverse[i] = -w[i] / (slope * (slope + w[i]))
        slope = slope + w[i]


def inverse_numbers(r: Sequence[float], w: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return r' and w' of a rate-independent operator.

    Raises:
        ConfigError: As in `check_invertible`.
    """
    check_invertible(r, w)
    r_inverse, w_inverse = [0.0] * len(r), [0.0] * len(r)
    invert([float(value) for value in r], [float(value) for value in w], r_inverse, w_inverse)
    return r_inverse, w_inverse


def check_invertible(r: Sequence[float], w: Sequence[float]) -> None:
    """Raise unless the closed form holds: thresholds rise from 0, and every slope is positive.

    Raises:
        ConfigError: A number that is not finite, unequal counts, thresholds that do not rise from 0, or a
            slope w_0 + … + w_i that is not positive.
    """
    if len(r) == 0 or not all(map(math.isfinite, r)) or r[0] != 0 or any(b < a for a, b in pairwise(r)):
        raise ConfigError(
            f"thresholds: found {list(r)}, expected finite numbers that rise from 0, as the inverse requires"
        )
    if len(w) != len(r) or not all(map(math.isfinite, w)):
        raise ConfigError(f"weights: found {list(w)}, expected {len(r)} finite numbers, one per threshold")
    slope = 0.0
    for i, value in enumerate(w):
        slope += value
        if slope <= 0:
            raise ConfigError(
                f"weights: numbers 0 to {i} sum to {slope:g}, expected a positive slope: "
                "the operator runs backwards and has no inverse"
            )
