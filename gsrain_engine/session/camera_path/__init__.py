"""The person's camera path: its keys, files, and how it is drawn."""
