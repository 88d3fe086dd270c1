"""Lightning's parser with torchpi's errors: one line with what was found and what was expected."""

import re
from typing import Any, NoReturn

from jsonargparse import ActionConfigFile  # type: ignore[attr-defined]
from lightning.pytorch.cli import LightningArgumentParser

from torchpi.cli.command_line import Parser
from torchpi.errors import ConfigError
from torchpi.files import config_file


class NamedConfig(ActionConfigFile):
    """A config by its path, or one of torchpi's own by its name."""

    def __call__(self, parser: Any, cfg: Any, values: Any, option_string: str | None = None) -> None:
        super().__call__(parser, cfg, str(config_file(values)), option_string)


class TrainParser(Parser, LightningArgumentParser):
    """The parser of `torchpi train`."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        # An abbreviated option is treated as a mistake and reported.
        super().__init__(*args, allow_abbrev=False, **kwargs)

    def add_argument(self, *args: Any, **kwargs: Any) -> Any:
        """Add an argument as the base class does; `--config` also takes names."""
        if kwargs.get("action") is ActionConfigFile:
            kwargs["action"] = NamedConfig
        return super().add_argument(*args, **kwargs)

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        text = re.sub(r"\s+", " ", message).strip()
        text = text.replace("Subcommand 'fit' does not accept option", "Option")
        nested = re.search(r"unknown option or key '[^']*'(; nearest is '[^']*')?", text)
        if nested:
            raise ConfigError(f"{nested[0]}; --help lists all") from ex
        super().error(text, ex)
