"""Verify calibrate: boards, register, check."""
