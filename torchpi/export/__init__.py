"""Exports: the compensator as a TorchScript file, and its bare numbers as JSON."""

from torchpi.export.numbers import save_json
from torchpi.export.torchscript import load_torchscript, save_torchscript

__all__ = ["load_torchscript", "save_json", "save_torchscript"]
