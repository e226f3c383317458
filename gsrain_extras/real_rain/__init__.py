"""Real rain beside ours, and a camera rain gauge, as commands of `gsrain evaluate`."""
