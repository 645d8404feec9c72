"""Check whether the rig still is as calibrated, from the LEDs of a session."""
