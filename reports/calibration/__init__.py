"""Reports on a calibration, its check and a registration."""
