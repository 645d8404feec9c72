"""CAMSHIFT, stereo localisation, Kalman tracks, identity."""
