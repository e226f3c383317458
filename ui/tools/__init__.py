"""The tools of the viewport: the one table of them. Another tool is another file here and another row."""

from .tool import Tool

TOOLS: tuple[Tool, ...] = ()
