"""The commands `gsrain evaluate ...`."""
