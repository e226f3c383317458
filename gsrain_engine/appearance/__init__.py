"""Appearance transfer: make views of dry scenes look rainy."""
