"""The report on many sessions."""
