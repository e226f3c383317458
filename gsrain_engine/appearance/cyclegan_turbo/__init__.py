"""CycleGAN-Turbo with normals and cross-view attention: the paper's transfer model."""
