"""The window's panels: read a session, draw it, call its methods. No maths, no files, no threads."""
