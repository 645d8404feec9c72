"""Arm motion, lights, rendering."""
