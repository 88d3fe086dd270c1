"""From what stands in a stage's file to its blocks: the signature of a block is the schema of its section."""

import difflib
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from torchpi.errors import ConfigError, StageError

Built = TypeVar("Built")


def read_yaml(path: str | Path) -> dict[str, Any]:
    """The settings in a YAML file.

    Raises:
        ConfigError: No such file, no YAML, or no mapping of keys to values; names the file.
    """
    import yaml  # not at the top: nothing else of a stage needs it

    try:
        settings = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        raise ConfigError(f"{path}{line}: not valid YAML: {getattr(error, 'problem', error)}") from error
    if not isinstance(settings, dict):
        raise ConfigError(f"{path}: found {type(settings).__name__}, want keys with values, one a line")
    return settings


def build(
    make: Callable[..., Built],
    settings: Mapping[str, Any] | None,  # None is an empty section: the ideal block
    section: str = "",  # "" is the top of the file
    *fixed: object,  # positional arguments, which do not stand in the file
) -> Built:
    """Call `make` with a section's settings as its keyword arguments.

    Raises:
        ConfigError: An unknown or missing key, with the nearest right one, or a value of the wrong kind.
        StageError: What `make` finds unphysical. Both begin with the key in full.
    """
    prefix = f"{section}." if section else ""
    if settings is not None and not isinstance(settings, Mapping):
        raise ConfigError(f"{section}: found {settings!r}, want a section of keys with values")
    parameters = {
        name: parameter
        for name, parameter in inspect.signature(make).parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    }
    arguments = {}
    for key, value in (settings or {}).items():
        if key not in parameters:
            nearest = difflib.get_close_matches(str(key), parameters, n=1, cutoff=0.0)[0]
            raise ConfigError(f"unknown key {prefix}{key}; the nearest one is {prefix}{nearest}")
        arguments[key] = _of_kind(value, str(parameters[key].annotation), f"{prefix}{key}")
    for key, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty and key not in arguments:
            raise ConfigError(f"{prefix}{key} is missing")
    try:
        return make(*fixed, **arguments)
    except StageError as error:
        raise StageError(f"{prefix}{error}") from error


def _of_kind(value: Any, kind: str, where: str) -> Any:
    """The value as the annotation wants it. YAML 1.1 takes 1e-4 for text: that is a number here."""
    if "Mapping" in kind or (value is None and "None" in kind):
        return value
    try:
        if "Sequence" in kind:
            if not isinstance(value, list | tuple):
                raise ValueError
            return [_number(part) for part in value]
        number = _number(value)
        if "int" not in kind:
            return number
        if number != int(number):
            raise ValueError
        return int(number)
    except (ValueError, OverflowError):
        one = "a whole number" if "int" in kind else "a number"
        wanted = "a list of numbers" if "Sequence" in kind else one
        raise ConfigError(f"{where}: found {value!r}, want {wanted}") from None


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError
    return float(value)
