"""`torchpi train`: a command line of Lightning's, in a package that stands above torchpi and imports it."""

from collections.abc import Mapping
from importlib import import_module, util
from types import ModuleType
from typing import Any


def train_cli() -> ModuleType:
    """In a wheel it lies inside torchpi, in a checkout beside it."""
    return import_module("torchpi.train.cli" if util.find_spec("torchpi.train") else "train.cli")


def parsers() -> Mapping[str, Any]:
    """Of its subcommands, for a shell's completions."""
    of_subcommands: Mapping[str, Any] = train_cli().Options().parsers()
    return of_subcommands
