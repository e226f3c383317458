"""Drives as Rerun recordings."""
