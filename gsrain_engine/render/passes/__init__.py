"""Passes of a picture: one effect a file, in the order of `registry.PASSES`."""
