"""Recorded drives, photogrammetry and pictures, each as one `Capture`."""
