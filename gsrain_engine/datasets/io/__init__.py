"""Files of data sets, read within limits."""
