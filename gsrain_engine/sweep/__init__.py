"""Sweeps: runs for every combination of scenes, scenarios, intensities, seeds and agents."""
