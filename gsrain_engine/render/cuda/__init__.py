"""CUDA renderer, based on gsplat."""
