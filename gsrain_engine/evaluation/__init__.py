"""Measuring images: FID, consistency, streaks, detection, lidar."""
