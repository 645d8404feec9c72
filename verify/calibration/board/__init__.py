"""A calibration board's pose from its corners, and its drawing to print."""
