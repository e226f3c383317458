"""The editor without a window: the document and its history, time, navigation, jobs, and what the view shows."""
