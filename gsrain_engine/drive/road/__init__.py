"""What a vehicle drives on, along and into."""
