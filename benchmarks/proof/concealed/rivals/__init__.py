"""Simple methods that a diagnosis has to outperform."""
