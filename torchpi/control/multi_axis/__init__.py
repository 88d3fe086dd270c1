"""Multi-axis compensators: n trajectories in, n voltages out."""

from torchpi.control.multi_axis.inverse import MultiAxisInverse, linear_inverses

__all__ = ["MultiAxisInverse", "linear_inverses"]
