"""The concealed rig, written apart from torchpi: a diagnosis cannot succeed by sharing its equations."""
