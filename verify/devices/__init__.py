"""Drivers that only read: ports, cameras, encoders, turning bases, MELFA controllers."""
