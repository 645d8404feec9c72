"""Calibration: corners, boards, registration."""
