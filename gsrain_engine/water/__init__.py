"""Water where it lands: on the glass in front of a camera."""
