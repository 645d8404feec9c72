"""A stereo pair in, the flange pose with covariance out. Pure: no disk, no device."""
