"""Simulated sessions as folders."""
