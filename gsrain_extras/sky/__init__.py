"""Skies for scenes: computed ones, and panoramas."""
