"""Where the scene is looked at from, and what lies where in the picture."""
