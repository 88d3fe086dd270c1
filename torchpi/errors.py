"""Errors and warnings about input that cannot be used.

Every error is one line: what was wrong, where, the value found, the value expected, and what to do.
The commands print that line without a traceback and exit with code 2.
"""

import math
from numbers import Integral, Real
from typing import TypeGuard


def kind_of(value: object) -> str:
    """What a value is, for an error: the name of its type, and the shape if it has one."""
    shape = getattr(value, "shape", None)
    name = type(value).__name__
    return f"{name} of {'×'.join(map(str, shape))}" if isinstance(shape, tuple) else name


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is one real number, of Python or of NumPy; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_positive(value: object) -> TypeGuard[float]:
    """Whether a value is a positive, finite number."""
    return is_number(value) and 0 < value < math.inf


def is_whole(value: object) -> TypeGuard[int]:
    """Whether a value is one whole number, of Python or of NumPy; True and False are none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


class TorchpiError(ValueError):
    """Base of every error that a user's input can cause."""


class RecordingError(TorchpiError):
    """A recording that cannot be read, or cannot be used: names the file and the row or column."""


class ConfigError(TorchpiError):
    """A configuration with an unknown key or an impossible value: names the key."""


def check_positive(name: str, value: object, unit: str) -> None:
    """Whether an argument is a positive, finite number.

    Raises:
        ConfigError: It is not; names the argument, what was found, and the unit expected.
    """
    if not is_positive(value):
        raise ConfigError(f"{name}: found {value!r}, expected a positive number of {unit}")


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
