"""`python -m torchpi` is the `torchpi` command."""

from torchpi.cli import main

if __name__ == "__main__":
    main()
