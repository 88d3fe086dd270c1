"""Recordings of voltage and displacement: read from files, checked, summarised, resampled, differentiated."""
