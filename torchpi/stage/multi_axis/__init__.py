"""A stage of several axes: shared modes, with hysteresis at each actuator and in the feedback."""

from torchpi.stage.multi_axis.stage import MultiAxisStage, MultiAxisState
from torchpi.stage.multi_axis.stream import MultiAxisStream

__all__ = ["MultiAxisStage", "MultiAxisState", "MultiAxisStream"]
