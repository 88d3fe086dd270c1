"""Known effects injected into real recordings."""
