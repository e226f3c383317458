"""Camera, navigation, picking and options of the viewport."""
