"""Compiled search for the LED of each spot."""
