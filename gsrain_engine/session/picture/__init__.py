"""What the viewport shows, frame by frame."""
