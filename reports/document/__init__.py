"""Blocks, charts and numbers as text, without a format."""
