"""Measured rain: drop spectra from disdrometer files, and what can be trusted in them."""
