"""Single-joint sweeps: segments, axis, encoder error."""
