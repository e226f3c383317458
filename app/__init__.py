"""The program: command line and window. Nothing here that another program would import."""
