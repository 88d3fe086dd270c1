"""The command line. Nothing is imported before it is called: a worker process imports this package too."""


def main() -> None:
    """Entry point."""
    from torchpi.cli.commands import main

    main()
