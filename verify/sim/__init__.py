"""One simulated world for simulated cameras and encoders; only commands and tests use it."""
