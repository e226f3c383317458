"""Scenes in zip files."""
