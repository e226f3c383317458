"""Files and streams from strangers: limits before memory, and errors in one sentence."""
