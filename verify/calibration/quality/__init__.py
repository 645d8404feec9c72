"""Fit, coverage, accuracy, advice, results."""
