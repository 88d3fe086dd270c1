"""torchpi in a notebook: NumPy in, NumPy out, results that draw and show themselves."""
