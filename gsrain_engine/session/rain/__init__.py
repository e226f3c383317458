"""The rain panels: measurements, calibrations, roofs, and the regions of rain in the view."""
