"""Recorded messages of robots and vehicles: MCAP files and ROS 2 bags."""
