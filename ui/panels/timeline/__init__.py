"""Parts of the Timeline panel."""
