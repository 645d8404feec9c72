"""The report on identified arm parameters."""
