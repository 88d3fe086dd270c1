"""Inputs that no controller should send, but that every controller sends at some time."""

import math
import random
import struct

import torch
from torch import Tensor

from tests.control.test_direct_inverse import THRESHOLDS
from torchpi.control.direct_inverse import DirectInverse

PERIOD_S = 1e-3
VOLTAGES_V = (-1.0, 9.0)
RANGE_UM = (0.0, 8.0)


def compensator(**changes: object) -> DirectInverse:
    """Return a monotone compensator of a stage of 8 µm, with every kind of state."""
    arguments = {
        "sample_period_s": PERIOD_S,
        "thresholds": THRESHOLDS,
        "range_um": 8.0,
        "rate_scale_um_s": 200.0,
        "rate": "linear",
        "lead": 2,
        "creep_time_constants_s": [0.01, 0.3, 5.0],
        "offset": True,
        "min_voltage_v": VOLTAGES_V[0],
        "max_voltage_v": VOLTAGES_V[1],
        "trained": {
            "range_um": RANGE_UM,
            "rates_um_s": (-200.0, 200.0),
            "voltages_v": (0.0, 8.5),
            "voltage_rates_v_s": (-250.0, 250.0),
            "accelerations_um_s2": (-6e3, 6e3),
        },
        **changes,
    }
    made = DirectInverse(**arguments)
    with torch.no_grad():
        made.weights.theta.fill_(-0.005)
        made.weights.theta[0] = torch.tensor([1.15, 0.05] if made.weights.kind == "linear" else [1.15])
        made.creep_gains.fill_(-0.01)
        made.offset.fill_(0.1)
        if len(made.scaled_lead):
            made.scaled_lead.copy_(torch.tensor([0.8, 0.1])[: len(made.scaled_lead)])
    return made


def like_the_demo() -> DirectInverse:
    """Return a compensator that remembers disturbances longest: its wide plays have considerable weights, its
    second-order lead amplifies jumps of the acceleration, at the sample rate of `configs/demo.yaml`."""
    thresholds = [0.0, 0.03, 0.12, 0.26, 0.46, 0.72, 1.04, 1.41, 1.85, 2.34, 2.88, 3.49, 4.15, 4.87]
    made = DirectInverse(
        1e-4,
        thresholds,
        range_um=8.0,
        rate_scale_um_s=1900.0,
        rate="linear",
        preview=2,
        lead=2,
        creep_time_constants_s=[1e-3, 0.01, 0.1, 1.0],
        min_voltage_v=VOLTAGES_V[0],
        max_voltage_v=VOLTAGES_V[1],
        trained={
            "range_um": RANGE_UM,
            "rates_um_s": (-1900.0, 1700.0),
            "voltages_v": (0.0, 8.5),
            "voltage_rates_v_s": (-2200.0, 2000.0),
            "accelerations_um_s2": (-2e6, 2e6),
        },
    )
    with torch.no_grad():
        made.weights.theta.fill_(-0.02)
        made.weights.theta[0] = torch.tensor([1.25, 0.02])
        made.weights.theta[1:, 1] = 0.002
        made.weights.theta[8:, 0] = -0.05
        made.creep_gains.fill_(-0.015)
        made.scaled_lead.copy_(torch.tensor([-3e-3, 6.3]))
    return made


def motion(samples: int, period_s: float = PERIOD_S) -> Tensor:
    """Return a sine of 5 Hz through the trained range."""
    t = period_s * torch.arange(samples, dtype=torch.float64)
    return 4.0 - 3.8 * torch.cos(2 * math.pi * 5 * t)


def hostile(seed: int) -> list[float]:
    """Return one to forty samples: signed zeros, denormals, huge numbers, inf, NaN, jumps, random bits."""
    rng = random.Random(seed)
    kinds = [
        lambda: rng.choice([0.0, -0.0]),
        lambda: rng.choice([5e-324, -5e-324, 2.2e-308, -1e-310]),
        lambda: rng.choice([1, -1]) * 10.0 ** rng.uniform(3, 308),
        lambda: rng.choice([1.7976931348623157e308, -1.7976931348623157e308]),
        lambda: rng.choice([math.inf, -math.inf, math.nan]),
        lambda: rng.uniform(-2.0, 10.0),
        lambda: rng.choice([20.0, -20.0, 12.0, 10.1, -2.1]),
        lambda: struct.unpack("<d", rng.randbytes(8))[0],
    ]
    chosen = rng.sample(kinds, rng.randint(1, len(kinds)))
    return [rng.choice(chosen)() for _ in range(rng.choice([1, 1, 2, 5, 40]))]


def disturbed(seed: int, samples: int, period_s: float = PERIOD_S) -> tuple[Tensor, int]:
    """Return the motion with hostile samples that start in its first 1.25 periods, and where they end."""
    yd, inserted = motion(samples, period_s), hostile(seed)
    start = random.Random(seed).randint(0, round(0.25 / period_s))
    yd[start : start + len(inserted)] = torch.tensor(inserted, dtype=torch.float64)
    return yd, start + len(inserted)
