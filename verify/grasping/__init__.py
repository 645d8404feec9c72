"""A coloured object tracked, planned for, followed and grasped; the only room that can move anything."""
