"""Export of the compensator as TorchScript, C99 or `.pt2`, and of its numbers as JSON."""

from torchpi.export.formats import FORMATS, export_files, made_files, write_together
from torchpi.export.safety_card import Load, SafetyCard, safety_card
from torchpi.export.torchscript import load_torchscript, trained_recordings

__all__ = [
    "FORMATS",
    "Load",
    "SafetyCard",
    "export_files",
    "load_torchscript",
    "made_files",
    "safety_card",
    "trained_recordings",
    "write_together",
]
