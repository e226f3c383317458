"""HUGSIM's pipe protocol: outside drivers, unchanged."""
