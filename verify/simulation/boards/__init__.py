"""Simulated board pictures."""
