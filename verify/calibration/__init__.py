"""Cameras from boards, robot base and LEDs from a motion or fixture, kinematic calibration of the arm, interim checks."""
