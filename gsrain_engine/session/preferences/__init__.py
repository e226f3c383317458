"""What a person prefers, and where the program keeps what belongs to no scene."""
