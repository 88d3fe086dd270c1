"""The shortest set of voltages whose recordings distinguish the effects of a stage: about a minute in all.

A hold shows noise, hum and drift. The odd multisine separates linear response, even and odd nonlinearity, and
non-periodic parts; two amplitudes of it separate a lag from a slew limit, and repeating it after ten minutes
shows ageing and slow drift. Stairs up and down separate creep from drift. Triangles show backlash, stiction
and rate dependence; their minor loops show whether loops at two biases are congruent.
"""

import numpy as np

from torchpi.errors import ConfigError
from torchpi.excitation.limits import (
    FADE,
    DriveLimits,
    largest_rate_v_s,
    multisine_swing,
    recorded,
    staircase,
    straight_lines,
    vibration,
)
from torchpi.excitation.signals import Samples, triangle_corners

HOLD_S, HOLD_AT = 5.0, 0.7  # level as a fraction of the limit farther from 0 V
PERIOD_S, PERIODS = 2.0, 3
SMALL = 0.3  # the second amplitude of the multisine, as a share of the first
STAIRS = (0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0)
STAIR_HOLDS_S = (1.0, 4.0, 1.0, 8.0, 1.0, 4.0, 1.0, 2.0)
AMPLITUDES, MINOR_BIASES, MINOR_AMPLITUDE, MINOR_LOOPS = (1.0, 0.6, 0.3), (0.3, 0.7), 0.2, 2
LEAST_HIGH_HZ = 20.0
LEAST_RATE = 2.0  # ranges per second; allows three different rates within a minute


def diagnostic_excitations(limits: DriveLimits, seed: int = 0) -> dict[str, Samples]:
    """Return the set by name, in the order in which to play it; each t (time,), s, and u (time,), V.

    Each excitation starts at 0 V, returns to 0 V, and stays within the limits; `multisine_again` is a copy
    of the large multisine, to be played ten minutes later.

    Args:
        limits: Drive limits of the stage and its amplifier.
        seed: Seed of the phases, and of the lines that the multisine leaves out.

    Raises:
        ConfigError: the rate or the band is too small for the range.

    Example:
        >>> from torchpi.excitation import DriveLimits, diagnostic_excitations
        >>> to_play = diagnostic_excitations(DriveLimits(max_voltage_v=8.0))
        >>> {name: round(float(u.max()), 1) for name, (t, u) in to_play.items() if "multisine" in name}
        {'multisine_large': 8.0, 'multisine_small': 5.2, 'multisine_again': 8.0}
    """
    if limits.high_hz < LEAST_HIGH_HZ:
        raise ConfigError(
            f"high_hz is {limits.high_hz:g} Hz, expected {LEAST_HIGH_HZ:g} Hz or more for a set of one minute"
        )
    swing = multisine_swing(limits, PERIOD_S, seed)
    wanted_v_s = max(largest_rate_v_s(limits, swing) / (1 - FADE), LEAST_RATE * limits.span_v)
    if wanted_v_s > limits.max_rate_v_s:
        raise ConfigError(
            f"max_rate_v_s is {limits.max_rate_v_s:g} V/s, expected {1.01 * wanted_v_s:.3g} V/s or more for "
            f"{limits.min_voltage_v:g}…{limits.max_voltage_v:g} V up to {limits.high_hz:g} Hz; "
            "allow a larger rate, a smaller range or a lower high_hz"
        )
    large, small = (recorded(limits, vibration(limits, share * swing, PERIODS)) for share in (1.0, SMALL))
    return {
        "hold": recorded(limits, hold_off_zero(limits)),
        "multisine_large": large,
        "multisine_small": small,
        "stairs": recorded(limits, staircase(limits, STAIRS, STAIR_HOLDS_S)),
        "triangles": recorded(limits, triangles_with_minor_loops(limits)),
        "multisine_again": large,
    }


def hold_off_zero(limits: DriveLimits) -> np.ndarray:
    """Return one level for HOLD_S, (time,), V; not the middle of the range, which may be 0 V."""
    farther_v = max(limits.min_voltage_v, limits.max_voltage_v, key=abs)
    return staircase(limits, [(HOLD_AT * farther_v - limits.min_voltage_v) / limits.span_v], [HOLD_S])


def triangles_with_minor_loops(limits: DriveLimits) -> np.ndarray:
    """Return triangles of three rates and amplitudes, and minor loops at two biases, (time,), V."""
    # The third harmonic of the smallest loop must lie within the band.
    fastest = min(limits.high_hz / 10, limits.max_rate_v_s / limits.span_v)
    slowest = float(np.clip(fastest / 16, 0.5, 1.0))
    fractions, seconds = triangle_corners(
        AMPLITUDES, np.geomspace(slowest, fastest, 3).tolist(), MINOR_BIASES, MINOR_AMPLITUDE, MINOR_LOOPS
    )
    return straight_lines(limits, fractions, seconds)
