"""`python -m train`."""

import sys

from torchpi.cli.command_line import run_program
from torchpi.cli.duration import announce_fit


def fit() -> None:
    """Print the estimated duration before importing Lightning, which takes seconds."""
    announce_fit(sys.argv[1:])
    from .cli import fit

    fit()


run_program(fit, "torchpi")
