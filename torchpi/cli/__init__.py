"""The command line. Imports wait until it is called, because worker processes import this package too."""


def main() -> None:
    """Run the command line; the entry point."""
    from torchpi.cli.commands import main

    main()
