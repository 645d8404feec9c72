"""Figures of a session's report."""
