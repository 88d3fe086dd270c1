"""The conditions of a recording: its history, how the stage is driven, and what the files contain.

None of this is physics of the plant. The same rig is recorded as people record theirs: it may not be
de-energised at the first sample, the command may never rest, the voltage may be a measured one, there are one
to four files, and the numbers may be in another unit.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from concealed.plant.excitation import Reach
from concealed.plant.physics import Array

SHORTEST_HOLD = 8  # samples of equal voltage; fewer belong to the edge of a step
# Exponents with which the scale factors of voltage and displacement act on a value of each unit.
POWERS = {
    "V": (1, 0),
    "V/s": (1, 0),
    "um": (0, 1),
    "um/V": (-1, 1),
    "1/V": (-1, 0),
    "1/V^2": (-2, 0),
    "1/um": (0, -1),
    "1/um^2": (0, -2),
}


@dataclass(frozen=True)
class Conditions:
    """How the rig is recorded; the defaults are those of the published tracks."""

    remanent: bool = False
    """A random history is played through the plant before the first sample that is recorded."""
    holds: bool = True
    """Without holds, a small triangle stands in place of each stretch of equal voltage."""
    monitored: bool = False
    """`input_v` is a measured voltage, with noise and small errors of gain and offset."""
    recordings: int = 3
    scale_v: float = 1.0
    """Factor on the voltages in the files, such as 10 for those behind the amplifier."""
    scale_um: float = 1.0
    """Factor on the displacements in the files, such as 1e-3 for millimetres."""

    def scaled(self, value: float, unit: str) -> float:
        """Convert a parameter of the plant to the units of the files."""
        volts, micrometres = POWERS.get(unit, (0, 0))
        return value * self.scale_v**volts * self.scale_um**micrometres


PLAIN = Conditions()


@dataclass(frozen=True)
class Monitor:
    """What the measured voltage adds to the command: u (1 + gain) + offset + noise."""

    gain: float
    offset_v: float
    noise_v: float


def draw_conditions(index: int, rng: np.random.Generator) -> Conditions:
    """Draw those of `nulls_conditions`: a third each remanent, without holds, with a monitored voltage."""
    return Conditions(
        remanent=index % 3 == 0,
        holds=index % 3 != 1,
        monitored=index % 3 == 2,
        recordings=int(rng.choice([1, 2, 3, 3, 3, 4])),
        scale_v=float(rng.choice([1.0, 1.0, 0.1, 10.0, 100.0])),
        scale_um=float(rng.choice([1.0, 1.0, 1e-3, 10.0, 1000.0])),
    )


def draw_history(rng: np.random.Generator, reach: Reach, first_v: float) -> Array:
    """The command before the record: ramps between random voltages, then a short rest at `first_v`."""
    turns = int(rng.integers(3, 9))
    levels = rng.uniform(reach.lower_v, 0.98 * reach.upper_v, turns)
    corners = np.concatenate([[0.0], levels, [first_v]])
    times = np.linspace(0, 1, corners.size)
    ramps = np.interp(np.linspace(0, 1, reach.samples // 2), times, corners)
    return np.concatenate([ramps, np.full(int(rng.uniform(0.005, 0.05) * reach.samples), first_v)])


def without_holds(u: Array, reach: Reach, rng: np.random.Generator) -> Array:
    """The command with a small triangle in place of each hold, towards the middle of the range."""
    u = u.copy()
    starts = np.concatenate([[0], np.flatnonzero(np.diff(u)) + 1, [u.size]])
    span = reach.upper_v - reach.lower_v
    for start, stop in pairwise(starts):
        count = stop - start
        if count < SHORTEST_HOLD:
            continue
        inward = -1.0 if u[start] > 0.5 * (reach.lower_v + reach.upper_v) else 1.0
        cycles = max(round(count / rng.uniform(300, 1200)), 1)
        phase = np.arange(count) / count * cycles
        u[start:stop] += inward * rng.uniform(0.02, 0.08) * span * (1 - np.abs(2 * (phase % 1) - 1))
    return u


def draw_monitor(rng: np.random.Generator, reach: Reach) -> Monitor:
    """Draw a voltage divider: gain within 1 %, offset 0.2 % of the span, noise 2 to 30 parts in 100,000."""
    span = reach.upper_v - reach.lower_v
    noise = math.exp(rng.uniform(math.log(2e-5), math.log(3e-4)))
    return Monitor(rng.uniform(-0.01, 0.01), rng.uniform(-0.002, 0.002) * span, noise * span)
