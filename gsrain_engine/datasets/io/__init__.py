"""File readers of datasets, with limits on size."""
