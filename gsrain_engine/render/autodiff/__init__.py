"""Differentiable rendering, for training."""
