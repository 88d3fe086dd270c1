"""`torchpi commission`: make a compensator, a stage and a page from recordings."""
