"""Find where a drive meets the limits of the voltage or of its rate."""

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
import numpy.typing as npt

from torchpi.loop.result import LimitMet, Signal

ANSWERS = 3
"""Number of samples after a voltage in which its displacement is read."""
SLACK = 1e-9
"""Relative tolerance: a rate that the compensator has limited differs from its limit by rounding."""


def limits_met(
    u: Signal,  # (time,), V
    yd: Signal,  # (time,), µm
    error_um: Signal,  # (time,), µm: displacement less y_d
    limited: npt.NDArray[np.bool_] | None,  # (time,): the compensator's limits changed the voltage
    low_v: float,
    high_v: float,
    max_slew_v_s: float,
    period_s: float,
) -> tuple[LimitMet, ...]:
    """Return the limits that a drive met: of the voltage, low and high, and of its rate.

    A voltage on a limit has met it only if the limit changed it; without `limited`, every voltage on a limit
    has. A change by next to nothing, as where a motion begins at 0 V, does not count: while the voltage lies
    on the limit, the stage has to be off, away from the limit, by more than the rms error of the motion.

    Args:
        u: Voltage written.
        yd: Desired displacement.
        error_um: Displacement less y_d; positive while a lower limit cuts the voltage.
        limited: Where a limit inside the compensator changed the voltage; None where that is not counted.
        low_v, high_v: Limits of the voltage.
        max_slew_v_s: Limit of its rate, from sample to sample; infinite where none is known.
        period_s: Sample period.
    """
    rate = np.abs(np.diff(u, prepend=u[:1])) / period_s
    at_low, at_high = u <= low_v, u >= high_v
    too_fast = rate >= max_slew_v_s * (1 - SLACK)
    if limited is not None:
        # A changed voltage that lies on no limit was changed by the slew limit inside the compensator.
        too_fast |= limited & ~at_low & ~at_high
        at_low, at_high = at_low & limited, at_high & limited
    at_low, at_high = _cut(at_low, error_um), _cut(at_high, -error_um)
    inside_v_s = float(rate[too_fast].min()) if too_fast.any() else math.inf
    found: list[tuple[Literal["voltage", "slew"], float, npt.NDArray[np.bool_], Signal]] = [
        ("voltage", low_v, at_low, u),
        ("voltage", high_v, at_high, u),
        ("slew", min(max_slew_v_s, inside_v_s), too_fast, rate),
    ]
    return tuple(
        _met(quantity, limit, where, values, yd, period_s)
        for quantity, limit, where, values in found
        if where.any()
    )


def _cut(where: npt.NDArray[np.bool_], away_um: Signal) -> npt.NDArray[np.bool_]:
    """Keep stretches in which, or `ANSWERS` samples after which, the error exceeds its rms."""
    rms_um = float(np.sqrt(np.mean(away_um**2)))
    kept = np.zeros_like(where)
    for first, stop in _stretches(where):
        kept[first:stop] = away_um[first : stop + ANSWERS].max() > rms_um
    return kept


def _met(
    quantity: Literal["voltage", "slew"],
    limit: float,
    where: npt.NDArray[np.bool_],
    values: Signal,
    yd: Signal,
    period_s: float,
) -> LimitMet:
    stretches = list(_stretches(where))
    first, stop = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    written = values[where]
    return LimitMet(
        quantity=quantity,
        limit=limit,
        value=float(written[np.argmax(np.abs(written))]),
        share=float(where.mean()),
        stretches=len(stretches),
        time_s=first * period_s,
        duration_s=(stop - first) * period_s,
        yd_um=float(yd[first]),
    )


def _stretches(where: npt.NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield the first and the past-the-end sample of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(np.int8)))
    for first, stop in edges.reshape(-1, 2):
        yield int(first), int(stop)
