"""`torchpi train`: a Lightning command line in a separate package that imports torchpi."""

from collections.abc import Mapping
from importlib import import_module, util
from types import ModuleType
from typing import Any


def train_cli() -> ModuleType:
    """Import the package, which lies inside torchpi in a wheel and beside it in a checkout."""
    return import_module("torchpi.train.cli" if util.find_spec("torchpi.train") else "train.cli")


def parsers() -> Mapping[str, Any]:
    """Return the parsers of its subcommands, for shell completion."""
    of_subcommands: Mapping[str, Any] = train_cli().Options().parsers()
    return of_subcommands
