"""The report on a planned session."""
