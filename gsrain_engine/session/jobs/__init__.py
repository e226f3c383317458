"""Work that goes on behind the window."""
