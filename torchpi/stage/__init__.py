"""The simulated stage: one file a block, and the chain of them."""

from torchpi.stage.actuator import Actuator
from torchpi.stage.amplifier import Amplifier
from torchpi.stage.augmented import AugmentedStage
from torchpi.stage.mechanics import Mechanics
from torchpi.stage.sensor import Sensor
from torchpi.stage.stage import Stage
from torchpi.stage.stream import StageStream

__all__ = ["Actuator", "Amplifier", "AugmentedStage", "Mechanics", "Sensor", "Stage", "StageStream"]
