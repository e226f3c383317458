"""What opens over the window: pages, questions, dialogs."""
