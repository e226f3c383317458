"""The ego vehicle: its shape, how it moves, and what follows a plan with it."""
