"""ROS bags and MCAP files, read into a session."""
