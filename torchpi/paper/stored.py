"""Frozen dataclasses of numbers and arrays, to a file and back: one .npz, its tree as JSON inside it."""

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
    """Write `result`, which took `seconds`, under `key`; whole or not at all."""
    arrays: dict[str, np.ndarray] = {}
    tree = json.dumps(_plain(result, arrays), allow_nan=True)
    with write_atomically(path) as temporary:
        about = {_TREE: np.array(tree), _KEY: np.array(key), _SECONDS: np.array(seconds)}
        np.savez_compressed(temporary, allow_pickle=False, **about, **arrays)


def restore(kind: type[T], key: str, path: Path) -> tuple[T, float] | None:
    """The `kind` at `path` under this key, and its seconds; None if it is not there, or cannot be read."""
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            if str(file[_KEY]) != key:
                return None
            result = _typed(kind, json.loads(str(file[_TREE])), file)
            return typing.cast(T, result), float(file[_SECONDS])
    except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile):
        # Cut short, of another version, or not ours: it is computed again.
        return None


def _plain(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """The value as JSON can hold it, its arrays put aside."""
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
    """The value as its annotation says it was."""
    origin, inside = typing.get_origin(kind), typing.get_args(kind)
    if origin in (types.UnionType, typing.Union):  # of a type and None
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
