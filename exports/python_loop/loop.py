"""A control loop with an exported compensator, without torchpi: python loop.py COMPENSATOR.pt [SAMPLES]

Prints the desired displacement and the voltage of each tick. In place of `print` stands the converter.
"""

import math
import sys
import warnings

import torch

warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
torch.set_num_threads(1)  # a step has nothing to share out

compensator = torch.jit.load(sys.argv[1])
samples = int(sys.argv[2]) if len(sys.argv) > 2 else 20
period, preview = compensator.sample_period_s, compensator.preview


def desired_um(tick: int) -> float:
    """The motion that is wanted, known ahead: a 5 Hz sine, 0 … 4 µm."""
    return 2 - 2 * math.cos(2 * math.pi * 5 * tick * period)


for _ in range(20):  # warm up
    compensator.step(0.0)
compensator.reset()

for tick in range(samples):
    voltage = compensator.step(desired_um(tick + preview))
    print(f"{tick * period:.6f} s  {desired_um(tick):.6f} um  {voltage:.17g} V")
