"""What the C of a compensator is tested with on its target: a motion, and the numbers of the Python step."""

import math
from typing import Any

from torchpi.control.step import CompensatorStream

SAMPLES = 600
NOT_FINITE = (250, 251, 420)  # samples at which the input is not a number


def recorded(stream: CompensatorStream) -> dict[str, Any]:
    """What NAME_selftest.c is made of: samples, those of them that it makes not finite, and the answers."""
    yd = inputs(stream)
    stream.reset()
    u = [stream.step(math.nan if k in NOT_FINITE else sample) for k, sample in enumerate(yd)]
    return {"samples": SAMPLES, "not_finite": NOT_FINITE, "yd": yd, "u": u}


def inputs(stream: CompensatorStream) -> list[float]:
    """Samples in µm that take the output through its range: large and small loops, slow, fast, and rest."""
    amplitude_um = 2.0**-10
    # Doubled until the limits are met, or nothing on the way to them is (a weight may be zero).
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
