"""Panels around the viewport, and the table of them."""
