"""Verify doctor: the machine, a station's devices."""
