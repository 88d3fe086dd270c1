"""Curvature of the sensor: y = x + a₂x² + a₃x³.

Fleming, *A review of nanometer-resolution position sensors: operation and performance*, Sensors and
Actuators A 190, 2013: the mapping error of a sensor as a polynomial of its input.
"""

from torch import nn

from torchpi.stage.effects.curvature import Curvature
from torchpi.stage.effects.effect import parameter


class SensorNonlinearity(Curvature):
    """A memoryless curvature of the reading; its slope at 0 is 1, for the stage has the gain."""

    name = "sensor_nonlinearity"
    block = "sensor"
    equation = "y = x + a₂x² + a₃x³"
    signature = "second (a₂) and third (a₃) harmonics of the displacement, in phase with it at any rate"
    time_scale = "static"
    degenerate_with = ("input_nonlinearity",)
    a2_per_um: nn.Parameter = parameter("1/µm", at_least=-1e3, at_most=1e3)
    a3_per_um2: nn.Parameter = parameter("1/µm²", at_least=-1e6, at_most=1e6)
