"""A station file and the devices it names."""
