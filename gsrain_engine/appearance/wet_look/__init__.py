"""The built-in wet look, without a network."""
