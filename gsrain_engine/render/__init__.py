"""Rendering: OpenGL, CPU and differentiable renderers, frame sequences, and image, video and label export."""
