"""The concealed rig, written independently of torchpi, so that no diagnosis succeeds by shared equations."""
