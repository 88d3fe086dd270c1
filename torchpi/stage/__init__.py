"""The stage: a hysteresis in a chain of effects, one effect a file."""

from torchpi.stage.stage import EffectSettings, Stage
from torchpi.stage.stream import StageStream

__all__ = ["EffectSettings", "Stage", "StageStream"]
