"""The page of a run, from its results and nothing else."""
