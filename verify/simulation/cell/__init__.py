"""The simulated grasping cell."""
