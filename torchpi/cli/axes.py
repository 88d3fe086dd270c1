"""Helpers of commands for several axes that avoid loading the modules for them."""

import json
from pathlib import Path

from torchpi.errors import ConfigError

SCHEMA = "torchpi.control.multi_axis/"
LARGEST_BYTES = 1 << 28


def numbers_of_axes(compensator: Path) -> Path | None:
    """Return NAME.json of an inverse of several axes for NAME.json or NAME.pt, None for any other."""
    path = compensator.with_suffix(".json")
    if compensator.suffix not in (".pt", ".json") or not path.is_file():
        return None
    if path.stat().st_size > LARGEST_BYTES:
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        return None
    found = content.get("schema") if isinstance(content, dict) else None
    return path if isinstance(found, str) and found.startswith(SCHEMA) else None


def refuse(**options: object) -> None:
    """Refuse options that do not exist for several axes.

    Args:
        options: The options by name; None for those not given.

    Raises:
        ConfigError: One of the options was given.
    """
    for option, found in options.items():
        if found is not None:
            raise ConfigError(f"--{option}: found {found}, expected none for several axes")
