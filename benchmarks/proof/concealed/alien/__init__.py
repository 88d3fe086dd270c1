"""Plants whose equations nobody who writes a diagnosis has read: other forms of each effect, other solvers."""
