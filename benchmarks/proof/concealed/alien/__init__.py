"""Plants whose equations no author of a diagnosis has read: other forms of each effect, other solvers."""
