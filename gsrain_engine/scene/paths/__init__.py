"""Ways of a camera: keys, the curves between them, how they are edited, and the files they come from."""
