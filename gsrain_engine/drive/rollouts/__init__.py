"""What happened in a drive, as a value and in files."""
