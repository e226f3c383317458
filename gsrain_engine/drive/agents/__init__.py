"""Drivers: what they are shown, and the plans that they make."""
