"""The panels around the picture, and the table of them."""
