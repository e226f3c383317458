"""CPU renderer: projection, tiles and compositing as Numba kernels."""
