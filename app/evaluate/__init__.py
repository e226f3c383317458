"""Commands of `gsrain evaluate`."""
