"""What a person edits, how it is looked at, and what is on its way into it."""
