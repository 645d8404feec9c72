"""The report on one session."""
