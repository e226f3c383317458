"""The window: panels, tools and dialogs draw the editor's parts, and call their methods. No math, files or threads."""
