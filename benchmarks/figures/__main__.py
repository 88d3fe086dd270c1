"""`python -m benchmarks.figures`."""

import sys

from torchpi.cli.command_line import run_program


def figures() -> None:
    """Run the command; it is imported only here, because importing torch takes seconds."""
    from benchmarks.figures.command import main

    sys.exit(main())


if __name__ == "__main__":
    run_program(figures, "python -m benchmarks.figures")
