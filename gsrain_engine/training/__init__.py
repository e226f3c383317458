"""Gaussians from images: initialization, optimization, densification."""
