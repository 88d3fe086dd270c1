"""What a diagnosis has to be better than."""
