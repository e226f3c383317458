"""Finished drives, played again in their scene."""
