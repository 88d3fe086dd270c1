"""Training with Lightning: recordings in, a trained direct inverse out. See `torchpi train fit --help`."""
