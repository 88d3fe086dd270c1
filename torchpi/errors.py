"""Errors and warnings about input that cannot be used.

Every error is one line: what was wrong, where, the value found, the value expected, and what to do.
The commands print that line without a traceback and exit with code 2.
"""

import math
from numbers import Integral, Real
from typing import TypeGuard


def kind_of(value: object) -> str:
    """Describe a value for an error message: the name of its type, and its shape if it has one."""
    shape = getattr(value, "shape", None)
    name = type(value).__name__
    return f"{name} of {'×'.join(map(str, shape))}" if isinstance(shape, tuple) else name


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a single real number, of Python or NumPy; True and False do not count."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_positive(value: object) -> TypeGuard[float]:
    """Whether a value is a positive, finite number."""
    return is_number(value) and 0 < value < math.inf


def is_whole(value: object) -> TypeGuard[int]:
    """Whether a value is a single whole number, of Python or NumPy; True and False do not count."""
    return isinstance(value, Integral) and not isinstance(value, bool)


class TorchpiError(ValueError):
    """Base of every error that a user's input can cause."""


class RecordingError(TorchpiError):
    """A recording that cannot be read or used; the message names the file and the row or column."""


class ConfigError(TorchpiError):
    """A configuration with an unknown key or an impossible value; the message names the key."""


def check_positive(name: str, value: object, unit: str) -> None:
    """Check that an argument is a positive, finite number.

    Raises:
        ConfigError: If it is not; the message names the argument, the value found and the unit expected.
    """
    if not is_positive(value):
        raise ConfigError(f"{name}: found {value!r}, expected a positive number of {unit}")


class StageError(TorchpiError):
    """A stage with an unphysical parameter; the message names the parameter and its unit."""


class ArtifactError(TorchpiError):
    """A run folder, checkpoint or exported file that is missing or is not what was expected."""


class SimulationError(TorchpiError):
    """A user's own simulation that is missing, fails, or does not return a displacement; names it."""


class RecordingWarning(UserWarning):
    """A recording that can be used, but contains something its owner should know about."""


class ExportWarning(UserWarning):
    """An export that can be used but lacks something; names the file and what would supply it."""
