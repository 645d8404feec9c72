"""Verify plan."""
