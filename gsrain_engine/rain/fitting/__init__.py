"""From drop spectra to a calibration: size law, number and fall speed over the intensity, with their uncertainty."""
