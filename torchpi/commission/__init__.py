"""Recordings in; a compensator, a stage and a page out: `torchpi commission`."""
