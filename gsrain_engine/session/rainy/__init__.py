"""Making a scene rainy: what a person chooses, and one view of how it will look."""
