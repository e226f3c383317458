"""The built-in street: one parametric description for both the Gaussians and the ground-truth mesh."""
