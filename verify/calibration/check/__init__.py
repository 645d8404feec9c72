"""Interim check of a calibration."""
