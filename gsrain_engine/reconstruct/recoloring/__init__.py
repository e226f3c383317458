"""Colours of fixed Gaussians solved for given views."""
