"""The control loop: step a compensator against a stage, sample by sample."""

from torchpi.loop.loop import run_loop
from torchpi.loop.result import LoopResult

__all__ = ["LoopResult", "run_loop"]
