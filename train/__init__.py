"""Train a direct inverse on recordings with Lightning; see `torchpi train fit --help`."""
