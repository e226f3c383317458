"""OpenGL renderer: compute passes and instanced quads."""
