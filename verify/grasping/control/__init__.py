"""State machine, watchdog, control loop."""
