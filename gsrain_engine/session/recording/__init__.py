"""Recording the document along its path, in another process."""
