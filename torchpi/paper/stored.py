"""Store frozen dataclasses of numbers and arrays in one .npz, with their tree as JSON, and restore them."""

import dataclasses
import json
import types
import typing
import zipfile
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from torchpi.files import write_atomically

T = TypeVar("T")
_TREE, _KEY, _SECONDS = "tree", "key", "seconds"


def store(result: Any, key: str, seconds: float, path: Path) -> None:
    """Write `result`, which took `seconds` to compute, under `key`, as a whole or not at all."""
    arrays: dict[str, np.ndarray] = {}
    tree = json.dumps(_plain(result, arrays), allow_nan=True)
    with write_atomically(path) as temporary:
        about = {_TREE: np.array(tree), _KEY: np.array(key), _SECONDS: np.array(seconds)}
        np.savez_compressed(temporary, allow_pickle=False, **about, **arrays)


def restore(kind: type[T], key: str, path: Path) -> tuple[T, float] | None:
    """Read the `kind` stored at `path` under this key, and its seconds; None if missing or unreadable."""
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            if str(file[_KEY]) != key:
                return None
            result = _typed(kind, json.loads(str(file[_TREE])), file)
            return typing.cast(T, result), float(file[_SECONDS])
    except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile):
        # The file is truncated, of another version or foreign, so the result is computed again.
        return None


def _plain(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """Convert the value for JSON and move its arrays into `arrays`."""
    if isinstance(value, np.ndarray):
        name = f"a{len(arrays)}"
        arrays[name] = value
        return name
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name), arrays) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): _plain(item, arrays) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item, arrays) for item in value]
    return value


def _typed(kind: Any, value: Any, arrays: Any) -> Any:
    """Convert a value from JSON back to the type of its annotation."""
    origin, inside = typing.get_origin(kind), typing.get_args(kind)
    if origin in (types.UnionType, typing.Union):  # a type or None
        (some,) = (one for one in inside if one is not type(None))
        return None if value is None else _typed(some, value, arrays)
    if kind is np.ndarray or origin is np.ndarray:
        return arrays[value]
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        return kind(**{name: _typed(hints[name], item, arrays) for name, item in value.items()})  # type: ignore
    if origin is dict:
        return {key: _typed(inside[1], item, arrays) for key, item in value.items()}
    if origin in (list, tuple):
        return origin(_typed(inside[0], item, arrays) for item in value)
    return value
