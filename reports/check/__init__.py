"""The report of an interim check."""
