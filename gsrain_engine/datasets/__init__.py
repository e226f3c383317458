"""Readers of driving datasets, photogrammetry and image folders, which each return a `Capture`."""
