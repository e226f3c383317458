"""OpenGL: contexts, the splat pipeline, frames, pictures and video."""
