"""`gsrain evaluate`: one module a command, and what each of them shows and writes."""
