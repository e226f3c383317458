"""Rasterization on the CPU: projection, tiles, compositing, and compositing's transpose."""
