"""Sessions written while they happen."""
