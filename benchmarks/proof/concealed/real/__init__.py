"""Known effects in real recordings."""
