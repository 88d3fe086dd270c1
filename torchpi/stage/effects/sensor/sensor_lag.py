"""The low-pass of a sensor and its electronics: one pole, or two as in filters behind demodulators.

Fleming, *A review of nanometer-resolution position sensors: operation and performance*, Sensors and Actuators
A 190, 2013.
"""

from torchpi.operators.linear import Hold, Matrices
from torchpi.stage.effects.effect import DataRange, Parameters
from torchpi.stage.effects.lag import Lag


class SensorLag(Lag):
    """A lag of a displacement, which runs straight from sample to sample, or is held as the command is."""

    name = "sensor_lag"
    block = "sensor"
    degenerate_with = ("amplifier_lag",)
    hold: Hold = "first"

    def matrices(self) -> Matrices:
        return self.discrete(self.hold)

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        # Near half the sample rate a lag is little more than a change of gain.
        return cls.starts_below(seen, 0.45 * seen.fs_hz)
