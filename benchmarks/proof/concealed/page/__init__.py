"""The page of a run, written from its results alone."""
