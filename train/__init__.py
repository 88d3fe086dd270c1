"""Training with Lightning: recordings in, a trained direct inverse out. See `python -m train fit --help`."""
