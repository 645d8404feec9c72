"""Many sessions: measured in a batch, and each joint followed over time."""
