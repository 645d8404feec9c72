"""Calibration of cameras by boards, of base and LEDs, of the arm's kinematics; interim checks."""
