"""Configs of stages that Lightning does not train: their single section and the files of their fit."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from torchpi.errors import ArtifactError, ConfigError
from torchpi.files import check_output_folder, config_file, write_text
from torchpi.stage.file import SavedStage
from torchpi.stage.settings import read_yaml

USAGE = "expected python -m train fit --config configs/NAME.yaml [--output FOLDER]"


def config_with(section: str, arguments: Sequence[str]) -> Path | None:
    """Return the config of a command line if it has this section, else None."""
    named = _options(arguments).get("config")
    if named is None or list(arguments[:1]) != ["fit"]:
        return None
    try:
        config = config_file(named)
        return config if section in read_yaml(config) else None
    except ConfigError:
        return None  # the other command reports the error


def settings_of(
    arguments: Sequence[str], config: Path, section: str, known: Sequence[str]
) -> tuple[dict[str, Any], Path]:
    """Return the checked settings of the section, and the folder for the results, new or empty.

    Raises:
        ConfigError: An option or a key is unknown.
        ArtifactError: The folder is in use or cannot be written to.
    """
    options = _options(arguments)
    if unknown := sorted(set(options) - {"config", "output"}):
        raise ConfigError(f"found the option --{unknown[0]}, {USAGE}")
    content = read_yaml(config)
    if other := sorted(set(content) - {section}):
        raise ConfigError(f"{config}: found the key {other[0]}, expected only {section}")
    settings = content[section]
    if not isinstance(settings, dict):
        raise ConfigError(f"{config}: {section}: found {settings!r}, expected keys with values")
    if wrong := sorted(set(settings) - set(known)):
        raise ConfigError(f"{config}: found the key {wrong[0]}, expected one of {', '.join(known)}")
    folder = Path(options.get("output", f"runs/{config.stem}"))
    check_output_folder(folder)
    if folder.is_dir() and any(folder.iterdir()):
        raise ArtifactError(f"--output {folder}: found a folder in use, expected a new or empty one")
    return settings, folder


def files_named(config: Path, found: object, otherwise: str = "") -> list[str]:
    """Return the recording files of a config.

    Raises:
        ConfigError: The value is not a list of files.
    """
    if isinstance(found, list) and found and all(isinstance(one, str) for one in found):
        return found
    raise ConfigError(f"{config}: recordings: found {found!r}, expected {otherwise}a list of files")


def whole_number(config: Path, name: str, found: object) -> int:
    """Return a checked count, such as a number of periods.

    Raises:
        ConfigError: The value is not a whole number from 1 on.
    """
    if isinstance(found, int) and not isinstance(found, bool) and found >= 1:
        return found
    raise ConfigError(f"{config}: {name}: found {found!r}, expected a whole number, 1 or more")


def leave(folder: Path, stage: SavedStage, metrics: Mapping[str, Any], content: Mapping[str, Any]) -> None:
    """Write stage.pt, metrics.json and config.yaml."""
    stage.save(folder / "stage.pt")
    for name, text in (
        ("metrics.json", json.dumps(metrics, indent=2)),
        ("config.yaml", yaml.safe_dump(dict(content))),
    ):
        write_text(folder / name, text + "\n")


def _options(arguments: Sequence[str]) -> dict[str, str]:
    """Parse options of the forms --NAME VALUE and --NAME=VALUE."""
    found: dict[str, str] = {}
    rest = list(arguments)
    while rest:
        word = rest.pop(0)
        if word.startswith("--"):
            name, given, value = word[2:].partition("=")
            found[name] = value if given else rest.pop(0) if rest else ""
    return found
