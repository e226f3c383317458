"""New colors for fixed geometry: the weighted least squares behind `gsrain recolor`."""
