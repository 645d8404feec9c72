"""Capture threads and drivers."""
