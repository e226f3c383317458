"""Where Gaussians are added, moved and taken away during a training."""
