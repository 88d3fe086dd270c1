"""Errors and warnings about input that cannot be used.

Every error is one line: what was wrong, where, the value found, the value expected, and what to do.
The commands print that line without a traceback and exit with code 2.
"""


def kind_of(value: object) -> str:
    """What a value is, for an error: the name of its type, and the shape if it has one."""
    shape = getattr(value, "shape", None)
    name = type(value).__name__
    return f"{name} of {'×'.join(map(str, shape))}" if isinstance(shape, tuple) else name


class TorchpiError(ValueError):
    """Base of every error that a user's input can cause."""


class RecordingError(TorchpiError):
    """A recording that cannot be read, or cannot be used: names the file and the row or column."""


class ConfigError(TorchpiError):
    """A configuration with an unknown key or an impossible value: names the key."""


class StageError(TorchpiError):
    """A stage with an unphysical parameter: names the parameter and its unit."""


class ArtifactError(TorchpiError):
    """A run folder, checkpoint or exported file that is missing, or is something else."""


class SimulationError(TorchpiError):
    """A simulation of someone's own that is missing, fails, or returns what is no displacement: names it."""


class RecordingWarning(UserWarning):
    """A recording that can be used, but holds something that its owner should know."""


class ExportWarning(UserWarning):
    """An export that can be used, but lacks something: names the file and what would bring it."""
