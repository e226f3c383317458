"""Scenes of OpenUSD (`.usdz`), with the files that NVIDIA's NuRec and AlpaSim read."""
