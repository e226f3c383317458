"""Rendering: OpenGL, CPU, CUDA and differentiable renderers, frame sequences, and image, video and label export."""
