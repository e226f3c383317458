"""Changes of a scene, each a function from one to the next."""
