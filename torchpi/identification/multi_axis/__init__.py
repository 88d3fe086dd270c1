"""Identification of a stage of several axes from periodic excitations at one or several amplitudes."""

from torchpi.identification.multi_axis.identify import MultiAxisOptions, identify

__all__ = ["MultiAxisOptions", "identify"]
