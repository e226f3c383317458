"""The paper's transfer model: CycleGAN-Turbo with normals and cross-view attention."""
