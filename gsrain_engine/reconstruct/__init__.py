"""Gaussians fitted to captures, and recoloured to given views."""
