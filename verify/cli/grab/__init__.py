"""Verify grab, simulated and on a station."""
