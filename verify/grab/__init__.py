"""Reaching for a coloured object: from pictures to a 3D track, and from the track to a grasp."""
