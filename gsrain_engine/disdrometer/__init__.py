"""Measured drop spectra: instruments, their files, calibrations fitted to them, and the virtual disdrometer."""
