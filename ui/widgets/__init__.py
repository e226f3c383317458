"""Widgets shared by panels and tools."""
