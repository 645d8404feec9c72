"""MELFA mover and Robotiq gripper behind one protocol."""
