"""Editor without a window: document, history, selection, viewport, jobs, files."""
