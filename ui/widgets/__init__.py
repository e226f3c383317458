"""Pieces that panels and tools are made of."""
