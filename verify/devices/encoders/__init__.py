"""LABENC, text lines, growing CSV; Universal Robots RTDE, ROS 2 by rosbridge, OPC UA."""
