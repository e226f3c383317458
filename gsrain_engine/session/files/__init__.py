"""Opening, saving and keeping what a person works on."""
