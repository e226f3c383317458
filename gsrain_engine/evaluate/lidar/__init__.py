"""What a lidar measures in the rain that the cameras see."""
