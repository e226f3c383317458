"""Many drives or renders as jobs that are done once each, and their tables."""
