"""Night look: captured scenes relit by lamps under a dark sky, Gaussian by Gaussian."""
