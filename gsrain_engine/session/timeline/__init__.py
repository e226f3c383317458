"""Time, and what happens in it."""
