"""torchpi for notebooks: NumPy arrays as inputs and outputs, and results that display and plot themselves."""
