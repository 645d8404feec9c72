"""Innovations, CUSUM, tolerance, loss of signal."""
