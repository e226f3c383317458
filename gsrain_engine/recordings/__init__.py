"""Rainy copies of recordings in their own format: pictures and lidar in rain, everything else as it was."""
