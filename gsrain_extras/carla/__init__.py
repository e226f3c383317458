"""CARLA's cameras and lidars in rain, as a renderer of carla-canvas."""
