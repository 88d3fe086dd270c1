"""Voltages for recording a stage within its drive limits, and trajectories to follow."""

from torchpi.excitation.limits import DriveLimits
from torchpi.excitation.sets import diagnostic_excitations
from torchpi.excitation.signals import make_excitation
from torchpi.excitation.trajectory import Trajectory, load_trajectory

__all__ = ["DriveLimits", "Trajectory", "diagnostic_excitations", "load_trajectory", "make_excitation"]
