"""The `gsrain` program: command line and launch of the window. Other programs import `gsrain` instead."""
