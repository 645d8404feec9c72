"""Verify identify."""
