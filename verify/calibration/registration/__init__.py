"""Robot base and LEDs from a motion or a fixture."""
