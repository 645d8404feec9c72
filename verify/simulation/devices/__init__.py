"""Simulated cameras, encoders, bases in real time."""
