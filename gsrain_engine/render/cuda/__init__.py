"""The CUDA back end, on gsplat."""
