"""The stage: a hysteresis in a chain of effects, one effect a file."""

from torchpi.stage.effect_settings import EffectSettings
from torchpi.stage.stage import Stage
from torchpi.stage.stream import StageStream

__all__ = ["EffectSettings", "Stage", "StageStream"]
