"""Water where it lands: on the glass in front of a camera, and on the ground."""
