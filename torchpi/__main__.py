"""`python -m torchpi` is the `torchpi` command."""

if __name__ == "__main__":  # a worker, which imports this file too, has no use for the command line
    from torchpi.cli.commands import main

    main()
