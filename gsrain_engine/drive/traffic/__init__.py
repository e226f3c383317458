"""Other road users: their looks, and the rules by which they move."""
