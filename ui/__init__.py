"""The window's panels: they read a session, draw it and call its methods. No math, no files, no threads."""
