"""High-frequency rain: what a person asks for, what follows from it, and the drops, streaks and haze it looks like."""
