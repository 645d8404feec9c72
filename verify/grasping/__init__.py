"""Track, follow and grasp a coloured object: the only room that can move anything."""
