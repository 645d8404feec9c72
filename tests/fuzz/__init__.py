"""Broken input by the thousand: `make fuzz N=2000`."""
