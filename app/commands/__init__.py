"""One command a file; each prints what it wrote."""
