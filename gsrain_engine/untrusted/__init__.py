"""Files and words of strangers, read with care: limits before memory is taken, nothing in them is run, one sentence."""
