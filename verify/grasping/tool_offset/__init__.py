"""Hand offset measured by the flange LEDs."""
