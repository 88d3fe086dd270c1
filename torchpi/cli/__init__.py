"""The command line. Nothing heavy is imported before a command has been chosen."""

from torchpi.cli.commands import main

__all__ = ["main"]
