"""The CPU back end: projection, tiles and compositing as Numba kernels."""
