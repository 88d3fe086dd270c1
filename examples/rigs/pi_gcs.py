"""Controllers of Physik Instrumente (PI) that speak GCS 2 and have a wave generator and a data recorder.

Such as E-709, E-712, E-727 and E-754. Needs `pip install pipython`. Commands are those of PI's manuals.
"""

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from rig import Signal, library

from torchpi.errors import ConfigError

SERVO_UPDATE_S = 0x0E000200
"""Parameter: the period of the controller's servo, s."""
POSITION = 2
"""Option of the data recorder: the actual position of the axis."""
POINTS_AT_ONCE = 10
"""Of a curve, sent in one line."""


@dataclass(frozen=True)
class PiGcs:
    """One axis, without its servo: points of the wave generator are voltages, as those of `SVA` are.

    Connect first: `with GCSDevice("E-727") as device: device.ConnectTCPIP("192.168.0.9")`.

    Attributes:
        device: A connected `pipython.GCSDevice`.
        fs_hz: Sample rate: that of the servo, or a whole part of it.
        axis: Its identifier.
        generator: Number of the wave generator, of its table, and of the table of the recorder.
        um_per_unit: Micrometres in the unit of the axis.
        min_voltage_v, max_voltage_v: What may be put out.
    """

    device: Any
    fs_hz: float
    axis: str = "1"
    generator: int = 1
    um_per_unit: float = 1.0
    min_voltage_v: float = 0.0
    max_voltage_v: float = 100.0

    def play(self, u_v: Signal) -> Signal:
        pitools = library("pipython.pitools", "pipython")
        cycles = self._cycles_of_a_sample()
        device, generator = self.device, self.generator
        device.SVO(self.axis, False)
        device.WTR(generator, cycles, 0)  # 0: held between points
        device.RTR(cycles)
        pitools.writewavepoints(device, generator, u_v.tolist(), POINTS_AT_ONCE)
        device.WSL(generator, generator)
        device.WGC(generator, 1)
        device.DRC(generator, self.axis, POSITION)
        device.WGO(generator, 1)  # starts the recorder too
        pitools.waitonwavegen(device, generator, timeout=len(u_v) / self.fs_hz + 10.0)
        device.WGO(generator, 0)
        device.qDRR(generator, 1, len(u_v))
        while device.bufstate is not True:  # a share of 1, as long as it reads
            time.sleep(0.01)
        return self.um_per_unit * np.array(device.bufdata[0], dtype=np.float64)

    def _cycles_of_a_sample(self) -> int:
        servo_s = float(self.device.qSPA(self.axis, SERVO_UPDATE_S)[self.axis][SERVO_UPDATE_S])
        cycles = max(1, round(1 / (self.fs_hz * servo_s)))
        if not math.isclose(cycles * servo_s * self.fs_hz, 1.0, rel_tol=1e-6):
            raise ConfigError(
                f"fs_hz: found {self.fs_hz:g} Hz, expected the servo's {1 / servo_s:g} Hz "
                f"or a whole part of it, such as {1 / (cycles * servo_s):g} Hz"
            )
        return cycles
