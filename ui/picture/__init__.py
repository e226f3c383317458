"""The picture and what stands over it."""
