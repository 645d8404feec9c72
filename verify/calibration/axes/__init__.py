"""Joint axes measured by one-joint sweeps, against the DH table."""
