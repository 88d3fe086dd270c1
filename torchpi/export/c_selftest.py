"""Data of the self-test that exported C runs on its target: a motion and the answers of the Python step."""

import math
from typing import Any

from torchpi.control.step import CompensatorStream

SAMPLES = 600
NOT_FINITE = (250, 251, 420)  # samples at which the input is NaN


def recorded(stream: CompensatorStream) -> dict[str, Any]:
    """Return the data of NAME_selftest.c: input samples, the indices of those set to NaN, and the answers."""
    yd = inputs(stream)
    stream.reset()
    u = [stream.step(math.nan if k in NOT_FINITE else sample) for k, sample in enumerate(yd)]
    return {"samples": SAMPLES, "not_finite": NOT_FINITE, "yd": yd, "u": u}


def inputs(stream: CompensatorStream) -> list[float]:
    """Return inputs in µm that drive the output through its range: large, small, slow, fast loops, rest."""
    amplitude_um = 2.0**-10
    # Doubled until the voltage limit is reached; bounded, because it may never be (a weight may be zero).
    while amplitude_um < 2.0**20 and not _at_a_limit(stream, amplitude_um):
        amplitude_um *= 2.0
    return _motion(amplitude_um)


def _motion(amplitude_um: float) -> list[float]:
    slow = [0.5 - 0.5 * math.cos(math.pi * k / 150) for k in range(SAMPLES - 100)]
    fast = [
        0.12 * math.sin(math.pi * k / 14) + 0.01 * math.sin(math.pi * k / 3) for k in range(SAMPLES - 100)
    ]
    moving = [amplitude_um * (a + b) for a, b in zip(slow, fast, strict=True)]
    return moving + [moving[-1]] * 40 + [sample / 2 for sample in moving[:60]]


def _at_a_limit(stream: CompensatorStream, amplitude_um: float) -> bool:
    stream.reset()
    voltages = [stream.step(sample) for sample in _motion(amplitude_um)[:200:3]]
    return max(voltages) >= stream.max_voltage_v
