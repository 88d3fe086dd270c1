"""Exports of stages with several axes, from arrays to arrays, as TorchScript, C99 and JSON."""

from torchpi.export.multi_axis.files import FORMATS, multi_axis_files

__all__ = ["FORMATS", "multi_axis_files"]
