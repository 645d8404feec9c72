"""The report of a robot's registration."""
