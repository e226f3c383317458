"""Rain: settings, physical properties, and the drops, streaks, haze and wetness derived from them."""
