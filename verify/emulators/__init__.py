"""Devices that are not there: they answer on a real port as the real ones do, faults included."""
