"""A driver in a closed loop with scene and rain."""
