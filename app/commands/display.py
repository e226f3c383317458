"""Whether a window can open."""

import os
import sys


def has_display() -> bool:
    """Tell from the environment; systems other than Linux always have a display."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
