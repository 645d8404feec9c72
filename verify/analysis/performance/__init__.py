"""ISO 9283 pose and path indices."""
