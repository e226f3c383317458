"""What a reconstruction begins with: first Gaussians, sky, ego mask, actors."""
