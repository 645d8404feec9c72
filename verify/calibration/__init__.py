"""From pictures of a board to a rig, from a motion or a board to the robot's place in it."""
