"""What a test is: where it begins, who else is there, in which rain; its files."""
