"""Files of strangers and of our own: limits before allocation, errors in one sentence, atomic writes, locks."""
