"""What a roll-out is worth, each measure by its definition."""
