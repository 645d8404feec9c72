"""Is the robot where it says it is: flange pose from two cameras, compared with the encoders."""
