"""Roll-outs for Foxglove: MCAP files with its messages."""
