from torchpi.cli.command_line import run_program


def fit() -> None:
    """Importing Lightning takes seconds."""
    from .cli import fit

    fit()


run_program(fit, "torchpi")
