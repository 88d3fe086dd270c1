"""External simulations: functions, and Functional Mock-up Units (FMUs)."""

from torchpi.simulators.loading import COLUMN, load_simulator
from torchpi.simulators.simulator import Simulate, Simulator

__all__ = ["COLUMN", "Simulate", "Simulator", "load_simulator"]
