"""Compiled alignment, pose fit and sensitivities."""
