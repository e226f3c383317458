"""The built-in street: one parametric description that becomes Gaussians and, for ground truth, a mesh."""
