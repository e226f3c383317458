"""Built-in wet look, without a neural network."""
