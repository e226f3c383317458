"""The closed loop of scene, rain and driver."""
