"""The training of a scene's Gaussians on a capture's views."""
