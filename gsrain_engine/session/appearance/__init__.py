"""Making a scene rainy, previews of it, and training a transfer."""
