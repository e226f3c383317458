"""The OpenGL back end: compute passes over tiles and quads."""
